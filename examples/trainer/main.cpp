// SPDX-License-Identifier: Apache-2.0
/// rye: capture, train, redirect, evaluate, export and render gaze-redirectable head avatars.
#include <cstdlib>
#include <iostream>
#include <new>

#include <CLI/CLI.hpp>
#ifdef _OPENMP
#include <omp.h>
#endif
#ifdef __GLIBC__
#include <malloc.h>
#endif
#ifdef __linux__
#include <unistd.h>
#endif

#include <rye/core/config.hpp>
#include <rye/core/error.hpp>

#include "commands/commands.hpp"

namespace rye::trainer {

void set_threads(int threads) {
#ifdef _OPENMP
    if (threads > 0) omp_set_num_threads(threads);
#else
    static_cast<void>(threads);
#endif
}

/// Restarts the program with sleeping instead of spinning OpenMP threads, unless the user has chosen
/// how they wait. Spinning threads of a waiting program take the processor from those that work: on
/// two cores, one busy process beside a training made its steps more than ten times as long. The
/// OpenMP runtime reads the setting before main begins, hence the restart. Returns where that is not
/// possible: then only the speed beside other programs differs.
void wait_asleep(char** argv) {
#if defined(_OPENMP) && defined(__linux__)
    for (const char* const name : {"OMP_WAIT_POLICY", "GOMP_SPINCOUNT", "KMP_BLOCKTIME"})
        if (std::getenv(name) != nullptr) return;
    if (setenv("OMP_WAIT_POLICY", "passive", 0) == 0) execv("/proc/self/exe", argv);
#else
    static_cast<void>(argv);
#endif
}

} // namespace rye::trainer

int main(int argc, char** argv) {
    using namespace rye::trainer;
    wait_asleep(argv);
#ifdef __GLIBC__
    // Feature maps of a few MB come and go in every step: keep their pages instead of returning
    // them to the system and faulting them in again.
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
