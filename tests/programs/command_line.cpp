// SPDX-License-Identifier: Apache-2.0
#include "command_line.hpp"

#include <iostream>
#include <sstream>

#include <CLI/CLI.hpp>

#include "commands/commands.hpp"
#include "commands/program.hpp"

namespace rye::trainer {

Answer answer(std::vector<std::string> words) {
    CLI::App app;
    app.name("rye");
    app.require_subcommand(1);
    add_commands(app);
    words.insert(words.begin(), "rye");
    std::vector<char*> argv;
    for (std::string& w : words) argv.push_back(w.data());
    std::ostringstream printed, heard;
    std::streambuf* const out = std::cout.rdbuf(printed.rdbuf());
    std::streambuf* const err = std::cerr.rdbuf(heard.rdbuf());
    const int code = run_program(app, static_cast<int>(argv.size()), argv.data());
    std::cout.rdbuf(out);
    std::cerr.rdbuf(err);
    return {code, printed.str(), heard.str()};
}

} // namespace rye::trainer
