// SPDX-License-Identifier: Apache-2.0
/// rye/core/thread_pool.hpp: a pool of std::threads that sleep while they wait, so that another
/// busy program on the machine costs no more than its share of the processors. Independent of
/// OpenMP; programs link the platform's thread library.
///     rye::ThreadPool pool(4);
///     const rye::XsimdBackend backend{pool.threads()};
#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <mutex>
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

    /// `count` threads, the caller's included; 0: one for each processor.
    explicit ThreadPool(int count = 0) {
        const int n = count > 0 ? count : static_cast<int>(std::thread::hardware_concurrency());
        for (int i = 1; i < n; ++i) workers_.emplace_back([this] { work(); });
    }
    ThreadPool(const ThreadPool&) = delete;
    ThreadPool& operator=(const ThreadPool&) = delete;
    ~ThreadPool() {
        {
            const std::lock_guard<std::mutex> lock(mutex_);
            ending_ = true;
        }
        wake_.notify_all();
        for (std::thread& t : workers_) t.join();
    }

    Handle threads() { return Handle(*this); }
    int size() const { return static_cast<int>(workers_.size()) + 1; }

    /// Calls f(0) ... f(n - 1) on the caller's thread and the pool's.
    template <std::invocable<Index> F>
    void run(Index n, F& f) {
        if (n <= 1 || workers_.empty() || busy_.exchange(true)) {
            for (Index i = 0; i < n; ++i) f(i);
            return;
        }
        detail::TaskErrors errors(n);
        const auto task = [&](Index i) { errors.guard(i, f); };
        Job job{n, &task, [](const void* t, Index i) {
                    (*static_cast<const decltype(task)*>(t))(i);
                }};
        {
            const std::lock_guard<std::mutex> lock(mutex_);
            job_ = &job;
            ++generation_;
        }
        const Index helpers = std::min(n - 1, static_cast<Index>(workers_.size()));
        for (Index i = 0; i < helpers; ++i) wake_.notify_one();
        job.take_all();
        {
            std::unique_lock<std::mutex> lock(mutex_);
            job_ = nullptr;                  // no worker joins from here on
            done_.wait(lock, [&] { return job.joined == 0; });
        }
        busy_.store(false);
        errors.rethrow_first();
    }

  private:
    struct Job {
        Index n;
        const void* task;
        void (*call)(const void*, Index);
        std::atomic<Index> next{0};
        int joined = 0;                      ///< workers in take_all; guarded by mutex_

        Job(Index count, const void* t, void (*c)(const void*, Index))
            : n(count), task(t), call(c) {}
        void take_all() {
            for (Index i = next.fetch_add(1); i < n; i = next.fetch_add(1)) call(task, i);
        }
    };

    void work() {
        std::uint64_t seen = 0;
        std::unique_lock<std::mutex> lock(mutex_);
        for (;;) {
            wake_.wait(lock, [&] { return ending_ || (job_ != nullptr && generation_ != seen); });
            if (ending_) return;
            seen = generation_;
            Job& job = *job_;
            ++job.joined;
            lock.unlock();
            job.take_all();
            lock.lock();
            if (--job.joined == 0) done_.notify_one();
        }
    }

    std::vector<std::thread> workers_;
    std::mutex mutex_;
    std::condition_variable wake_, done_;
    Job* job_ = nullptr;
    std::uint64_t generation_ = 0;
    bool ending_ = false;
    std::atomic<bool> busy_{false};
};
static_assert(Threads<ThreadPool::Handle>);

} // namespace rye
