// SPDX-License-Identifier: Apache-2.0
/// tests/programs/command_line.hpp: command lines, run by the program's code in this process.
#pragma once

#include <string>
#include <vector>

namespace rye::trainer {

/// Answer of the program to a command line.
struct Answer {
    int code = 0;
    std::string printed; ///< by std::cout
    std::string text;    ///< on standard error
};

/// Runs `rye` with these words.
Answer answer(std::vector<std::string> words);

} // namespace rye::trainer
