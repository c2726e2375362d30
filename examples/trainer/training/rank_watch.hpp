// SPDX-License-Identifier: Apache-2.0
/// training/rank_watch.hpp: a thread that looks whether another rank has ended while this one may
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

#include "training/ranks.hpp"

namespace rye::trainer {

/// Calls act(reason) once if another rank ends while it lives. If this rank still has not left a
/// call that waits for others some seconds later, ends the program with the reason.
class RankWatch {
  public:
    /// `ranks` must outlive it.
    RankWatch(Ranks& ranks, std::function<void(const std::string&)> act)
        : thread_([this, &ranks, own = std::move(act)] { watch(ranks, own); }) {}
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
    void watch(Ranks& ranks, const std::function<void(const std::string&)>& act) {
        const std::chrono::milliseconds between(200);
        const std::chrono::seconds patience(10); // with the silence of a process below 30 s
        std::unique_lock<std::mutex> lock(mutex_);
        const auto over = [&] { return over_; };
        std::string reason;
        while (reason.empty()) {
            if (done_.wait_for(lock, between, over)) return;
            lock.unlock();
            reason = ranks.ended();
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
        std::cerr << "rye train: " << reason << std::endl;
        std::_Exit(1);
    }

    std::mutex mutex_;
    std::condition_variable done_;
    bool over_ = false;
    std::thread thread_; // last: it uses the others
};

} // namespace rye::trainer
