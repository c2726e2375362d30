// SPDX-License-Identifier: Apache-2.0
/// rye: capture, train, redirect, evaluate, export and render gaze-redirectable head avatars.
#include <iostream>
#include <new>

#include <CLI/CLI.hpp>
#ifdef __GLIBC__
#include <malloc.h>
#endif

#include <rye/core/config.hpp>
#include <rye/core/error.hpp>

#include "commands/commands.hpp"

int main(int argc, char** argv) {
    using namespace rye::trainer;
#ifdef __GLIBC__
    // Keeps freed pages: feature maps of a few MB are allocated in every step, and returning them
    // to the system would fault them in again.
    mallopt(M_MMAP_THRESHOLD, 1 << 30);
    mallopt(M_TRIM_THRESHOLD, 1 << 30);
#endif
    const std::string version = std::to_string(RYE_VERSION_MAJOR) + "." +
                                std::to_string(RYE_VERSION_MINOR) + "." +
                                std::to_string(RYE_VERSION_PATCH);
    CLI::App app{"rye " + version + ": gaze-redirectable Gaussian head avatars.\n"
                 "A first tour: rye capture --out head; rye train --capture head --out run "
                 "--preset tiny;\nrye redirect --run run --sweep --out sweep.png; rye evaluate "
                 "--run run --capture head"};
    app.set_version_flag("--version", version);
    app.require_subcommand(1);
    add_capture(app);
    add_import(app);
    add_info(app);
    add_train(app);
    add_redirect(app);
    add_evaluate(app);
    add_export(app);
    add_render(app);
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& e) {
        return app.exit(e);
    } catch (const rye::Error& e) {
        std::cerr << "rye: " << e.what() << "\n";
        return 2;
    } catch (const std::bad_alloc&) {
        std::cerr << "rye: out of memory\n";
        return 3;
    } catch (const std::exception& e) {
        std::cerr << "rye: " << e.what() << "\n";
        return 2;
    }
    return 0;
}
