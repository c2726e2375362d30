// SPDX-License-Identifier: Apache-2.0
/// device/rank_watch.hpp: a thread that looks whether another rank has ended while this one may
/// wait for it. In a header, since units of nvcc use it too.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdlib>
#include <functional>
#include <iostream>
#include <mutex>
#include <string>
#include <thread>
#include <utility>

#include "model/ranks.hpp"

namespace rye::trainer {

/// How long ranks may take for something that they do together, such as joining NCCL.
struct RankLimit {
    std::chrono::duration<double> most{}; ///< 0: none
    std::string words;                    ///< what to say when it is over
};

/// Calls act(reason) once if another rank ends while it lives. If this rank still has not left a
/// call that waits for others some seconds later, ends the program with the reason.
class RankWatch {
  public:
    using Told = std::function<void(const std::string&)>;

    /// `ranks` must outlive it. end(reason) ends the program, also when the limit is over.
    RankWatch(Ranks& ranks, Told act, RankLimit limit = {}, Told end = end_program)
        : limit_(std::move(limit)),
          end_(std::move(end)),
          thread_([this, &ranks, own = std::move(act)] { watch(ranks, own); }) {}
    RankWatch(const RankWatch&) = delete;
    RankWatch& operator=(const RankWatch&) = delete;
    ~RankWatch() {
        {
            const std::lock_guard<std::mutex> lock(mutex_);
            over_ = true;
        }
        done_.notify_all();
        thread_.join();
    }

  private:
    [[noreturn]] static void end_program(const std::string& reason) {
        std::cerr << "rye train: " << reason << std::endl;
        std::_Exit(1);
    }

    void watch(Ranks& ranks, const Told& act) {
        const auto begin = std::chrono::steady_clock::now();
        const std::chrono::milliseconds between(200);
        const std::chrono::seconds patience(10); // with the silence of a process below 30 s
        std::unique_lock<std::mutex> lock(mutex_);
        const auto over = [&] { return over_; };
        std::string reason;
        while (reason.empty()) {
            if (done_.wait_for(lock, between, over)) return;
            lock.unlock();
            reason = ranks.ended();
            const bool late =
                limit_.most.count() > 0 && std::chrono::steady_clock::now() - begin > limit_.most;
            if (reason.empty() && late) return end_(limit_.words);
            lock.lock();
        }
        // The act may hang as the rank itself does, in a library that waits for the one that ended.
        lock.unlock();
        std::thread acting(act, reason);
        lock.lock();
        if (done_.wait_for(lock, patience, over)) {
            lock.unlock();
            acting.join();
            return;
        }
        acting.detach();
        end_(reason);
    }

    RankLimit limit_;
    Told end_;
    std::mutex mutex_;
    std::condition_variable done_;
    bool over_ = false;
    std::thread thread_; // last: it uses the others
};

} // namespace rye::trainer
