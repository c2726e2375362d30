// SPDX-License-Identifier: Apache-2.0
/// rye/core/parallel.hpp: threads as values, and fixed chunks, so that results do not depend on the
/// number of threads. Kinds: the caller's thread (`Serial`), OpenMP (`OpenMp`), a pool
/// (core/thread_pool.hpp), or the host program's own, by any type that models `Threads`. The kind
/// is a type and so part of every symbol that uses it: translation units built with and without
/// OpenMP can be linked together.
#pragma once

#include <algorithm>
#include <atomic>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <functional>
#include <memory>
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

/// Tasks [0, n), a band of successive ones for each thread. A thread takes those of its own band,
/// then what others have left: so it returns to the same part of the data call after call, where
/// its cache still holds it, and two threads seldom write side by side.
class TaskBands {
  public:
    explicit TaskBands(int threads)
        : count_(threads),
          bands_(std::make_unique<Band[]>(static_cast<std::size_t>(threads))) {}
    /// Deals n tasks; to be called before any thread takes one.
    void deal(Index n) {
        for (int i = 0; i < count_; ++i) {
            at(i).next.store(begin_of(i, n), std::memory_order_relaxed);
            at(i).end = begin_of(i + 1, n);
        }
    }
    /// Calls f of tasks until none is left.
    template <class F>
    void take(int thread, F&& f) {
        for (int k = 0; k < count_; ++k) {
            Band& band = at((thread + k) % count_);
            const auto next = [&] { return band.next.fetch_add(1, std::memory_order_relaxed); };
            if (band.next.load(std::memory_order_relaxed) >= band.end) continue;
            for (Index i = next(); i < band.end; i = next()) f(i);
        }
    }

  private:
    struct alignas(64) Band {
        std::atomic<Index> next{0};
        Index end = 0;
    };
    Band& at(int i) { return bands_[static_cast<std::size_t>(i)]; }
    Index begin_of(int i, Index n) const {
        return static_cast<Index>(static_cast<std::int64_t>(n) * i / count_);
    }

    int count_;
    std::unique_ptr<Band[]> bands_;
};

} // namespace detail

#ifdef _OPENMP
/// OpenMP's threads. They wait as the OpenMP runtime is configured: GNU's spin by default, which
/// slows other programs down; with OMP_WAIT_POLICY=passive, or a `ThreadPool`, they sleep. Where
/// the system starts no more threads GNU's runtime ends the process; a `ThreadPool` goes on with
/// fewer.
struct OpenMp {
    int count = 0; ///< number of threads; 0: omp_get_max_threads()

    template <std::invocable<Index> F>
    void run(Index n, F&& f) const {
        if (n == 1) return f(0);
        detail::TaskErrors errors(n);
        const int threads = size();
        detail::TaskBands bands(threads);
        bands.deal(n);
#pragma omp parallel num_threads(threads)
        bands.take(omp_get_thread_num(), [&](Index i) { errors.guard(i, f); });
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

namespace detail {

/// Returns the number of chunks of at most `grain` items; a function of its arguments alone.
constexpr Index chunk_count(Index n, Index grain) { return (n + grain - 1) / grain; }

} // namespace detail

/// Calls f(begin, end, chunk) for the fixed chunks of [0, n).
template <Threads P, class F>
    requires std::invocable<F, Index, Index, Index>
void for_chunks(const P& threads, Index n, Index grain, F&& f) {
    threads.run(detail::chunk_count(n, grain),
                [&](Index c) { f(c * grain, std::min(n, (c + 1) * grain), c); });
}

/// Returns the sum of f(begin, end) over fixed chunks, added in the order of the chunks.
template <Threads P, class R, class F>
    requires std::invocable<F, Index, Index> R sum_chunks(const P& threads, Index n, Index grain,
                                                          const R& zero, F&& f) {
        std::vector<R> parts(static_cast<std::size_t>(detail::chunk_count(n, grain)), zero);
        for_chunks(threads, n, grain, [&](Index b, Index e, Index c) {
            parts[static_cast<std::size_t>(c)] = f(b, e);
        });
        R total = zero;
        for (const R& p : parts) total += p;
        return total;
    }

namespace detail {

/// Work on the elements of one of several arrays: run(begin, end) does a part of it.
struct ArrayWork {
    Index size;
    std::function<void(Index, Index)> run;
};

} // namespace detail

/// Calls run for the fixed chunks of every array, all side by side, so that small arrays leave no
/// thread idle.
template <Threads P>
void for_chunks(const P& threads, const std::vector<detail::ArrayWork>& arrays, Index grain) {
    struct Piece {
        const detail::ArrayWork* of;
        Index begin;
    };
    std::vector<Piece> pieces;
    for (const detail::ArrayWork& a : arrays)
        for (Index b = 0; b < a.size; b += grain) pieces.push_back({&a, b});
    threads.run(static_cast<Index>(pieces.size()), [&](Index i) {
        const Piece& p = pieces[static_cast<std::size_t>(i)];
        p.of->run(p.begin, std::min(p.of->size, p.begin + grain));
    });
}

} // namespace rye
