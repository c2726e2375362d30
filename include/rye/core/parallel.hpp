// SPDX-License-Identifier: Apache-2.0
/// rye/core/parallel.hpp: threads as values, and fixed chunks, so that results do not depend on the
/// number of threads. Kinds: the caller's thread (`Serial`), OpenMP (`OpenMp`), a pool
/// (core/thread_pool.hpp), or the host program's own, by any type that models `Threads`. The kind
/// is a type and so part of every symbol that uses it: translation units built with and without
/// OpenMP can be linked together.
#pragma once

#include <algorithm>
#include <concepts>
#include <exception>
#include <type_traits>
#include <vector>

#include <rye/core/config.hpp>

#ifdef _OPENMP
#include <omp.h>
#endif

namespace rye {

/// run(n, f) calls f(0) ... f(n - 1) once each, in any order and on any threads, and returns when
/// all are done; size() is the number that run at once. An exception of f must propagate to the
/// caller of run; of several, that of the lowest index.
template <class P>
concept Threads = std::copy_constructible<P> && requires(const P& p, void (*f)(Index)) {
    p.run(Index(1), f);
    { p.size() } -> std::convertible_to<int>;
};

/// The calling thread, in order.
struct Serial {
    template <std::invocable<Index> F>
    void run(Index n, F&& f) const {
        for (Index i = 0; i < n; ++i) f(i);
    }
    int size() const { return 1; }
};
static_assert(Threads<Serial>);

namespace detail {

/// The exceptions of n tasks, one slot a task.
class TaskErrors {
  public:
    explicit TaskErrors(Index n) : errors_(static_cast<std::size_t>(n)) {}
    /// Runs f(i) and stores its exception.
    template <class F>
    void guard(Index i, F&& f) {
        try {
            f(i);
        } catch (...) {
            errors_[static_cast<std::size_t>(i)] = std::current_exception();
        }
    }
    void rethrow_first() const {
        for (const auto& e : errors_)
            if (e) std::rethrow_exception(e);
    }

  private:
    std::vector<std::exception_ptr> errors_;
};

} // namespace detail

#ifdef _OPENMP
/// OpenMP's threads. They wait as the OpenMP runtime is configured: GNU's spin by default, which
/// slows other programs down; with OMP_WAIT_POLICY=passive, or a `ThreadPool`, they sleep.
struct OpenMp {
    int count = 0; ///< number of threads; 0: omp_get_max_threads()

    template <std::invocable<Index> F>
    void run(Index n, F&& f) const {
        if (n == 1) return f(0);
        detail::TaskErrors errors(n);
        const int threads = size();
#pragma omp parallel for schedule(dynamic, 1) num_threads(threads)
        for (Index i = 0; i < n; ++i) errors.guard(i, f);
        errors.rethrow_first();
    }
    int size() const { return count > 0 ? count : omp_get_max_threads(); }
};
static_assert(Threads<OpenMp>);
/// The threads of a backend that names none: OpenMP's, or the caller's where the unit has no
/// OpenMP.
using DefaultThreads = OpenMp;
#else
/// The threads of a backend that names none: OpenMP's, or the caller's where the unit has no
/// OpenMP.
using DefaultThreads = Serial;
#endif

/// Number of chunks of at most `grain` items; a function of its arguments alone.
constexpr Index chunk_count(Index n, Index grain) { return (n + grain - 1) / grain; }

/// Calls f(begin, end, chunk) for the fixed chunks of [0, n).
template <Threads P, class F>
    requires std::invocable<F, Index, Index, Index>
void for_chunks(const P& threads, Index n, Index grain, F&& f) {
    threads.run(chunk_count(n, grain),
                [&](Index c) { f(c * grain, std::min(n, (c + 1) * grain), c); });
}

/// Sum of f(begin, end) over fixed chunks, added in the order of the chunks.
template <Threads P, class R, class F>
    requires std::invocable<F, Index, Index> R sum_chunks(const P& threads, Index n, Index grain,
                                                          const R& zero, F&& f) {
        std::vector<R> parts(static_cast<std::size_t>(chunk_count(n, grain)), zero);
        for_chunks(threads, n, grain, [&](Index b, Index e, Index c) {
            parts[static_cast<std::size_t>(c)] = f(b, e);
        });
        R total = zero;
        for (const R& p : parts) total += p;
        return total;
    }

} // namespace rye
