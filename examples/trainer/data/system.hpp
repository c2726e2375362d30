// SPDX-License-Identifier: Apache-2.0
/// data/system.hpp: what differs between systems, but for programs that are started
/// (data/started_program.hpp): system_posix.cpp, system_windows.cpp.
#pragma once

#include <array>
#include <csignal>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <rye/io/bytes.hpp>

namespace rye::trainer {

/// Makes the words of the command line UTF-8, the standard streams keep their bytes, and the
/// terminal show UTF-8 and obey control sequences, as they do on POSIX systems.
void begin_program(int& argc, char**& argv);

/// Returns a variable of the environment; nothing if it is not there or empty.
std::optional<std::string> environment(const char* name);

// ---- signals -----------------------------------------------------------------------------------

/// Signals that ask the program to stop: of a terminal, and of another process.
#ifdef SIGBREAK
inline constexpr std::array stop_signals{SIGINT, SIGTERM, SIGBREAK};
#else
inline constexpr std::array stop_signals{SIGINT, SIGTERM};
#endif

/// Returns the exit code of a program that stopped because of a signal.
int code_of_stop(int signal);

/// Makes a file that exceeds the limit of file sizes an error instead of the program's end.
void ignore_file_size_signal();

// ---- terminal and standard output --------------------------------------------------------------

enum class Stream { output = 1, errors = 2 };

bool is_terminal(Stream stream);

/// Returns the columns of the terminal that standard output is; 0 if unknown.
std::size_t terminal_width();

/// Writes to standard output, unbuffered; throws an Error if it cannot be written.
void write_output(ByteSpan bytes);

// ---- this process and its machine --------------------------------------------------------------

/// Returns the memory of the machine, or this process's own limit if lower [bytes].
double machine_memory();

/// Returns this program's file.
std::filesystem::path program_file();

/// Returns a name of the running system, which its containers share and a restart changes; that of
/// the machine where it has none.
std::string system_name();

/// Returns words such as "process 12 on HOST since 2026-01-02T03:04:05Z".
std::string process_words();

// ---- files -------------------------------------------------------------------------------------

/// File that text is appended to.
class AppendedFile {
  public:
    /// Why a text could not be written. undone: the file has none of it.
    struct Failure {
        std::string reason;
        bool undone;
    };
    /// Throws an Error if there is no such file, or it cannot be written.
    explicit AppendedFile(const std::filesystem::path& path);
    ~AppendedFile();
    AppendedFile(const AppendedFile&) = delete;
    AppendedFile& operator=(const AppendedFile&) = delete;

    /// Appends all of the text, or none of it.
    std::optional<Failure> append(std::string_view text);

  private:
    int file_ = -1;
};

/// File with words, of which one process at a time has the lock, until the object or the process
/// ends.
class LockFile {
  public:
    enum class Taking { done, held_by_another, no_locks };

    /// children_too: programs that are started meanwhile have the lock too. Throws an Error if the
    /// file cannot be made.
    LockFile(std::filesystem::path path, bool children_too);
    ~LockFile();
    LockFile(const LockFile&) = delete;
    LockFile& operator=(const LockFile&) = delete;

    Taking take();
    /// Returns what take() would, without the lock; others may ask at once. `done` without a file.
    static Taking look(const std::filesystem::path& path);
    std::string words() const;             ///< at most 400 bytes
    void write(const std::string& words);  ///< when the lock is taken; a full disk is no error

  private:
    std::filesystem::path path_;
    bool children_too_;
    int file_ = -1;
};

} // namespace rye::trainer
