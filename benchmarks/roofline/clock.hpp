// SPDX-License-Identifier: Apache-2.0
/// benchmarks/roofline/clock.hpp: clocks, the least of several times, and values that the compiler
/// knows nothing about.
#pragma once

#include <algorithm>
#include <ctime>

namespace rye::bench {

/// CPU time of this thread [s], independent of other load.
inline double thread_seconds() {
    std::timespec t{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}
/// Wall-clock time [s].
inline double wall_seconds() {
    std::timespec t{};
    clock_gettime(CLOCK_MONOTONIC, &t);
    return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

/// Returns the minimum of several times of f() [s]. The thread's clock is for runs that other load
/// interrupts. In a virtual machine it may leave out more than the interruptions, tens of
/// microseconds: runs shorter than a millisecond take wall_seconds.
template <class F>
double least_time(int times, F&& f, double (*clock)() = thread_seconds) {
    double least = 1e30;
    for (int i = 0; i < times; ++i) {
        const double start = clock();
        f();
        least = std::min(least, clock() - start);
    }
    return least;
}

/// Prevents the compiler from assuming that x is unread or unchanged.
template <class X>
void opaque(X& x) {
    asm volatile("" : "+m"(x) : : "memory");
}

} // namespace rye::bench
