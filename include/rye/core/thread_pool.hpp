// SPDX-License-Identifier: Apache-2.0
/// rye/core/thread_pool.hpp: a pool of std::threads that sleep while they wait, so that another
/// busy program on the machine costs no more than its share of the processors. Before it sleeps a
/// thread looks for work for 25 microseconds for each thread of the pool, at most 400, as waking
/// many takes longer. Independent of OpenMP; programs link the platform's thread library.
///     rye::ThreadPool pool(4);
///     const rye::XsimdBackend backend{pool.threads()};
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

#include <rye/core/parallel.hpp>

namespace rye {

/// Owns the threads and joins them in its destructor. Concurrent and nested calls of run are safe:
/// while the pool is busy, the caller runs its tasks itself.
class ThreadPool {
  public:
    /// A handle that models `Threads`; the pool must outlive it.
    class Handle {
      public:
        explicit Handle(ThreadPool& pool) : pool_(&pool) {}
        template <std::invocable<Index> F>
        void run(Index n, F&& f) const {
            pool_->run(n, f);
        }
        int size() const { return pool_->size(); }

      private:
        ThreadPool* pool_;
    };

    /// Starts `count` threads, the caller's included; 0: one for each processor. Where the system
    /// starts no more, the pool has those that it did start: size() is smaller than asked(), and
    /// results are the same.
    explicit ThreadPool(int count = 0)
        : asked_(count > 0 ? count
                           : std::max(1, static_cast<int>(std::thread::hardware_concurrency()))) {
        try {
            start();
        } catch (...) {
            end();
            throw;
        }
    }
    ThreadPool(const ThreadPool&) = delete;
    ThreadPool& operator=(const ThreadPool&) = delete;
    ~ThreadPool() { end(); }

    Handle threads() & { return Handle(*this); }
    /// Returns the number of threads that run at once, the caller's included.
    int size() const { return static_cast<int>(workers_.size()) + 1; }
    /// Returns the number of threads that the constructor was to start, the caller's included.
    int asked() const { return asked_; }

    /// Calls f(0) ... f(n - 1) on the caller's thread and the pool's.
    template <std::invocable<Index> F>
    void run(Index n, F& f) {
        if (n <= 1 || workers_.empty() || busy_.exchange(true)) {
            for (Index i = 0; i < n; ++i) f(i);
            return;
        }
        detail::TaskErrors errors(n);
        const auto task = [&](Index i) { errors.guard(i, f); };
        job_ = {&task, [](const void* t, Index k) { (*static_cast<const decltype(task)*>(t))(k); }};
        bands_.deal(n);
        open_.store(true);
        wake(std::min(n - 1, static_cast<Index>(workers_.size())));
        take_all(0);
        open_.store(false);                  // no thread joins any more
        const auto left = [&] { return inside_.load() == 0; };
        if (!spin_until(left)) {
            std::unique_lock<std::mutex> lock(mutex_);
            done_.wait(lock, left);
        }
        busy_.store(false);
        errors.rethrow_first();
    }

  private:
    struct Job {
        const void* task;
        void (*call)(const void*, Index);
    };

    /// Workers read nothing but atomics and what mutex_ guards until the first job opens.
    void start() {
        workers_.reserve(static_cast<std::size_t>(asked_) - 1);
        try {
            for (int i = 1; i < asked_; ++i) workers_.emplace_back([this, i] { work(i); });
        } catch (const std::system_error&) {
            // No more threads or no room for their stacks.
        }
        bands_ = detail::TaskBands(size());
    }
    void end() {
        ending_.store(true);
        generation_.fetch_add(1);
        {
            const std::lock_guard<std::mutex> lock(mutex_);
        }
        wake_.notify_all();
        for (std::thread& t : workers_) t.join();
    }

    void take_all(int thread) {
        bands_.take(thread, [&](Index i) { job_.call(job_.task, i); });
    }

    void wake(Index helpers) {
        generation_.fetch_add(1);
        int asleep = 0;
        {
            const std::lock_guard<std::mutex> lock(mutex_);
            asleep = asleep_;
        }
        to_wake_.store(static_cast<int>(std::min<Index>(helpers, asleep)));
        wake_two();
    }
    /// Wakes two threads. Each wakes two more: the caller alone would wait for every one in turn.
    void wake_two() {
        for (int i = 0; i < 2 && to_wake_.load() > 0 && to_wake_.fetch_sub(1) > 0; ++i)
            wake_.notify_one();
    }

    /// Returns true if ready() came true before the thread should sleep.
    template <class Ready>
    bool spin_until(const Ready& ready) const {
        const std::chrono::microseconds longest(std::min(25 * asked_, 400));
        const auto start = std::chrono::steady_clock::now();
        while (!ready())
            if (std::chrono::steady_clock::now() - start > longest) return false;
        return true;
    }

    /// A worker is counted as inside before it looks whether the job is open, and the caller closes
    /// the job before it looks whether anyone is inside: so the job outlives every use of it.
    void work(int thread) {
        std::uint64_t seen = 0;
        for (;;) {
            const auto called = [&] { return generation_.load() != seen; };
            if (!spin_until(called)) {
                std::unique_lock<std::mutex> lock(mutex_);
                ++asleep_;
                wake_.wait(lock, called);
                --asleep_;
                lock.unlock();
                wake_two();
            }
            seen = generation_.load();
            if (ending_.load()) return;
            inside_.fetch_add(1);
            if (open_.load()) take_all(thread);
            if (inside_.fetch_sub(1) == 1 && !open_.load()) {
                const std::lock_guard<std::mutex> lock(mutex_);
                done_.notify_one();
            }
        }
    }

    int asked_;
    std::vector<std::thread> workers_;
    std::mutex mutex_;
    std::condition_variable wake_, done_;
    int asleep_ = 0;                           ///< workers in wake_.wait; guarded by mutex_
    std::atomic<int> to_wake_{0};              ///< number of sleeping workers to wake
    Job job_{};                                ///< changed only while nobody is inside
    detail::TaskBands bands_{1};               ///< job's tasks
    std::atomic<bool> open_{false};            ///< true if workers may join
    std::atomic<int> inside_{0};               ///< workers that may touch the job
    std::atomic<std::uint64_t> generation_{0}; ///< number of jobs so far
    std::atomic<bool> ending_{false};
    std::atomic<bool> busy_{false};
};
static_assert(Threads<ThreadPool::Handle>);

} // namespace rye
