// SPDX-License-Identifier: Apache-2.0
/// commands/completion.hpp: shell completion and the manual page, made of the commands, options and
/// sentences of --help.
#pragma once

#include <string>

namespace CLI {
class App;
}

namespace rye::trainer {

/// Returns a script that completes commands, options, their choices, files and folders.
std::string bash_completion(const CLI::App& app);
std::string zsh_completion(const CLI::App& app);
std::string fish_completion(const CLI::App& app);

/// Returns a text in single quotes: one word of a shell's command line.
std::string shell_word(const std::string& text);

/// Returns a page for man(1), in the macros of man(7).
std::string manual_page(const CLI::App& app, const std::string& version);

} // namespace rye::trainer
