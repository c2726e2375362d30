// SPDX-License-Identifier: Apache-2.0
/// commands/child_jobs.hpp: commands of `rye` as child processes, several at once. SIGINT or
/// SIGTERM ends all of them, as `rye train` ends: with a checkpoint. Where the system supports it,
/// so does the end of this process for any reason.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace rye::trainer {

/// Sequence of `rye` command lines: each starts if the previous one ended with code 0.
struct ChildJob {
    std::string name;
    std::vector<std::vector<std::string>> commands; ///< without the program's name
    std::filesystem::path log;                      ///< receives the commands' output; overwritten
    /// Called until it returns true, which lets the job start; may change the commands. Empty:
    /// starts at once. A job starts regardless if no other one runs.
    std::function<bool(ChildJob&)> ready = {};
};

struct ChildResult {
    int code = 0;        ///< 128 + signal for a process ended by a signal
    std::string message; ///< last line of standard error
    double seconds = 0;
};

/// Runs the jobs, `at_once` at a time and in order, except those that are not ready; calls `ended`
/// with the index and result of each job that ends. `enough`, if not empty, is called several times
/// a second; once it returns true the jobs are stopped as by a signal. Returns the signal that
/// stopped them, or 0.
int run_children(std::vector<ChildJob> jobs, int at_once,
                 const std::function<void(std::size_t, const ChildResult&)>& ended,
                 const std::function<bool()>& enough = {});

/// Returns the last line that is not empty; nothing if there is none.
std::string last_line(const std::filesystem::path& path);

} // namespace rye::trainer
