// SPDX-License-Identifier: Apache-2.0
/// commands/child_jobs.hpp: commands of `rye` that run as child processes, several at once.
/// SIGINT or SIGTERM ends all of them, as `rye train` ends: with a checkpoint. Where the system has
/// a way, so does the end of this process, whatever ended it.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace rye::trainer {

/// Command lines of `rye`, one after the other: the next one starts if this one ends with code 0.
struct ChildJob {
    std::string name;
    std::vector<std::vector<std::string>> commands; ///< without the program's name
    std::filesystem::path log;                      ///< takes the commands' output; written anew
    /// Called until it returns true, which lets the job start; it may change the commands. Empty:
    /// at once. A job that nothing runs beside starts whatever it returns.
    std::function<bool(ChildJob&)> ready = {};
};

struct ChildResult {
    int code = 0;        ///< 128 + signal for a process that a signal ended
    std::string message; ///< the last line of standard error
    double seconds = 0;
};

/// Runs them, `at_once` at a time and in their order, but for those that are not ready; `ended` is
/// called with the index and result of each as it ends. Returns the signal that stopped all, or 0.
int run_children(std::vector<ChildJob> jobs, int at_once,
                 const std::function<void(std::size_t, const ChildResult&)>& ended);

} // namespace rye::trainer
