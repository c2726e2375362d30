// SPDX-License-Identifier: Apache-2.0
/// commands/completion.hpp: shell completion and the manual page, made of the same commands,
/// options and sentences as --help.
#pragma once

#include <string>

namespace CLI {
class App;
}

namespace rye::trainer {

/// Scripts that complete commands, options, their choices, files and folders.
std::string bash_completion(const CLI::App& app);
std::string zsh_completion(const CLI::App& app);
std::string fish_completion(const CLI::App& app);

/// A page for man(1), in the macros of man(7).
std::string manual_page(const CLI::App& app, const std::string& version);

} // namespace rye::trainer
