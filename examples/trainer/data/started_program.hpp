// SPDX-License-Identifier: Apache-2.0
/// data/started_program.hpp: a child process, which ends with this one: started_program_posix.cpp,
/// started_program_windows.cpp.
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace rye::trainer {

/// Files that a program's output goes to: `out` is appended to, `errors` is overwritten.
struct OutputFiles {
    std::filesystem::path out, errors;
};

/// Program that runs beside this one, without input.
class StartedProgram {
  public:
    /// Starts a program; words: with its own name. Its output is for read(). Throws an Error if it
    /// cannot be started.
    StartedProgram(const std::filesystem::path& file, const std::vector<std::string>& words);
    /// The same with its output in files, and in a group of its own, so that a terminal's Ctrl-C
    /// reaches this process alone.
    StartedProgram(const std::filesystem::path& file, const std::vector<std::string>& words,
                   const OutputFiles& output);
    ~StartedProgram();
    StartedProgram(StartedProgram&&) noexcept;
    StartedProgram& operator=(StartedProgram&&) noexcept;

    /// Calls `take` with the bytes of its standard output (false) and standard error (true), until
    /// it has closed both.
    void read(const std::function<void(bool, std::string_view)>& take);
    /// Waits until it ends; returns its code, 128 + signal for one that a signal ended.
    int wait();
    /// Returns the code if it has ended.
    std::optional<int> ended();
    /// Asks it to end: by SIGTERM, or Ctrl-Break.
    void stop();

  private:
    struct Process;
    std::unique_ptr<Process> process_;
};

/// Returns the file by which this program is started again.
std::filesystem::path own_program();

/// Returns the folders where programs are.
std::vector<std::filesystem::path> program_folders();

/// Returns the program of this name in a folder; nothing if there is none.
std::optional<std::filesystem::path> program_in(const std::filesystem::path& folder,
                                                const std::string& name);

} // namespace rye::trainer
