// SPDX-License-Identifier: Apache-2.0
// What --help says of defaults that a command decides itself.
#include <string>

#include <doctest/doctest.h>
#include <CLI/CLI.hpp>

#include "commands/commands.hpp"

using namespace rye::trainer;

TEST_CASE("help: a camera's options have each its own default") {
    CLI::App app{"rye"};
    add_render(app);
    add_redirect(app);
    const auto help = [&](const char* command, const char* option) {
        return app.get_subcommand(command)->get_option(option)->get_description();
    };
    const auto says = [&](const char* command, const char* option, const std::string& words) {
        INFO(help(command, option));
        CHECK(help(command, option).find("(" + words) != std::string::npos);
    };
    says("render", "--up", "default: 0,-1,0;");
    says("render", "--fov", "default: 40;");
    says("render", "--size", "default: 512x512;");
    says("render", "--look-at", "needed for a splat file;");
    says("redirect", "--look-at", "default: the middle of the face)");
    for (const char* option : {"--up", "--fov", "--size"})
        says("redirect", option, "default: that of --camera)");
    // A default is of one option: no help has that of another.
    for (const char* option : {"--up", "--fov"})
        CHECK(help("render", option).find("512x512") == std::string::npos);
    CHECK(help("render", "--size").find("0,-1,0") == std::string::npos);
    CHECK(app.get_subcommand("render")->help().find("40 and 512x512") == std::string::npos);
}
