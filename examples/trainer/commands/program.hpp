// SPDX-License-Identifier: Apache-2.0
/// commands/program.hpp: the program around its commands: one sentence for a wrong command line,
/// exit codes, and the options as completion scripts and the manual describe them.
///
/// Exit codes: 0 success; 1 the command ran, and its answer is no (`rye info`: not usable); 2 a
/// wrong command line, an unusable input, or no memory or disk for the work. A training stopped by
/// a signal exits with 128 and the signal's number, as shells do.
#pragma once

#include <string>
#include <vector>

namespace CLI {
class App;
class Option;
} // namespace CLI

namespace rye::trainer {

inline constexpr int exit_no = 1;    ///< the command's answer is no
inline constexpr int exit_fault = 2; ///< the command failed

/// Parses the command line, which runs the command; returns the exit code. Faults are one line on
/// standard error, which begins with the program and the command.
int run_program(CLI::App& app, int argc, char** argv);

/// Returns the candidate that the word most likely means: one that it begins, or one within a third
/// of its length in inserted, deleted, changed or swapped letters. Empty if there is none.
std::string near_miss(const std::string& word, const std::vector<std::string>& candidates);

/// Returns all commands of the program, their names, or all options of a command with a long name,
/// in order.
std::vector<const CLI::App*> commands_of(const CLI::App& app);
std::vector<std::string> names_of(const CLI::App& app);
std::vector<const CLI::Option*> options_of(const CLI::App& command);

/// Kind of value that an option takes.
struct OptionValue {
    enum class Kind { none, word, choice, number, file, folder } kind = Kind::none;
    std::vector<std::string> choices;
};
OptionValue value_of(const CLI::Option& option);

/// Returns the description without a default that the help adds.
std::string text_of(const CLI::Option& option);

} // namespace rye::trainer
