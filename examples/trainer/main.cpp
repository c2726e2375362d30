// SPDX-License-Identifier: Apache-2.0
/// rye: capture, train, redirect, evaluate, export and render gaze-redirectable head avatars.
#include <CLI/CLI.hpp>
#ifdef __GLIBC__
#include <malloc.h>
#endif

#include <rye/core/config.hpp>

#include "commands/commands.hpp"
#include "commands/program.hpp"
#include "data/system.hpp"

int main(int argc, char** argv) {
    using namespace rye::trainer;
#ifdef __GLIBC__
    // Keeps freed pages: feature maps of a few MB are allocated in every step, and returning them
    // to the system would fault them in again.
    mallopt(M_MMAP_THRESHOLD, 1 << 30);
    mallopt(M_TRIM_THRESHOLD, 1 << 30);
#endif
    begin_program(argc, argv);
    const std::string version = std::to_string(RYE_VERSION_MAJOR) + "." +
                                std::to_string(RYE_VERSION_MINOR) + "." +
                                std::to_string(RYE_VERSION_PATCH);
    CLI::App app{"rye " + version + ": gaze-redirectable Gaussian head avatars.\n"
                 "A first tour: rye capture --out head; rye train --capture head --out run "
                 "--preset tiny;\nrye redirect --run run --sweep --out sweep.png; rye evaluate "
                 "--run run --capture head"};
    app.name("rye");
    app.allow_windows_style_options(false); // /name is a path
    app.set_version_flag("--version", version);
    app.require_subcommand(1);
    app.footer(
        "Exit codes: 0 done; 1 the command ran and its answer is no (rye info, rye import: not "
        "usable; rye compare --collect: not complete); "
        "2 a wrong command line, an unusable input, or no memory or disk for the work.");
    add_commands(app);
    return run_program(app, argc, argv);
}
