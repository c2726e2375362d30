// SPDX-License-Identifier: Apache-2.0
/// rye/core/parallel.hpp: threads with fixed chunks, so that results do not depend on their number.
/// The kind of threading is a type and so part of every symbol that uses it: translation units
/// built with and without OpenMP can be linked together.
#pragma once

#include <algorithm>
#include <concepts>
#include <exception>
#include <vector>

#include <rye/core/config.hpp>

#ifdef _OPENMP
#include <omp.h>
#endif

namespace rye {

/// run(n, f) calls f(0) ... f(n - 1), each once, in any order, and returns when all are done.
/// The first exception by index is rethrown.
template <class P>
concept Threads = requires(void (*f)(Index)) { P::run(Index(1), f); };

/// One thread, in order.
struct Serial {
    template <std::invocable<Index> F>
    static void run(Index n, F&& f) {
        for (Index i = 0; i < n; ++i) f(i);
    }
    static int count() { return 1; }
};
static_assert(Threads<Serial>);

#ifdef _OPENMP
/// OpenMP's threads; omp_set_num_threads or OMP_NUM_THREADS says how many.
struct OpenMp {
    template <std::invocable<Index> F>
    static void run(Index n, F&& f) {
        if (n == 1) return f(0);
        std::vector<std::exception_ptr> failed(static_cast<std::size_t>(n));
        bool any = false;
#pragma omp parallel for schedule(dynamic, 1)
        for (Index i = 0; i < n; ++i) {
            try {
                f(i);
            } catch (...) {
                failed[static_cast<std::size_t>(i)] = std::current_exception();
#pragma omp atomic write
                any = true;
            }
        }
        if (any)
            for (const auto& e : failed)
                if (e) std::rethrow_exception(e);
    }
    static int count() { return omp_get_max_threads(); }
};
static_assert(Threads<OpenMp>);
using DefaultThreads = OpenMp;
#else
using DefaultThreads = Serial;
#endif

/// Number of chunks of at most `grain` items; depends on nothing but its arguments.
constexpr Index chunk_count(Index n, Index grain) { return (n + grain - 1) / grain; }

/// Calls f(begin, end, chunk) for the fixed chunks of [0, n).
template <Threads P, class F>
    requires std::invocable<F, Index, Index, Index>
void for_chunks(Index n, Index grain, F&& f) {
    P::run(chunk_count(n, grain),
           [&](Index c) { f(c * grain, std::min(n, (c + 1) * grain), c); });
}

/// Sums what f(begin, end) returns over fixed chunks, in the order of the chunks.
template <Threads P, class R, class F>
    requires std::invocable<F, Index, Index>
R sum_chunks(Index n, Index grain, const R& zero, F&& f) {
    std::vector<R> parts(static_cast<std::size_t>(chunk_count(n, grain)), zero);
    for_chunks<P>(n, grain, [&](Index b, Index e, Index c) {
        parts[static_cast<std::size_t>(c)] = f(b, e);
    });
    R total = zero;
    for (const R& p : parts) total += p;
    return total;
}

} // namespace rye
