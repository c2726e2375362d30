// SPDX-License-Identifier: Apache-2.0
/// data/process.hpp: other programs, found by their names and run as child processes that end with
/// this one.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace rye::trainer {

/// Returns the first of these names that is a program in a folder of PATH; nothing if none is.
std::optional<std::filesystem::path> find_program(const std::vector<std::string>& names);

/// How a program ended.
struct ProgramEnd {
    int code = 0;        ///< 128 + signal for one that a signal ended
    std::string message; ///< last lines of its standard error, at most 600 bytes
};

/// Runs a program, words[0], without input, until it ends; calls `line` with each line of its
/// standard output. Throws an Error if it cannot be started.
ProgramEnd run_program(const std::vector<std::string>& words,
                       const std::function<void(std::string_view)>& line = {});

} // namespace rye::trainer
