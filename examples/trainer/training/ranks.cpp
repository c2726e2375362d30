// SPDX-License-Identifier: Apache-2.0
#include "training/ranks.hpp"

#include <chrono>
#include <condition_variable>
#include <cstdlib>
#include <iostream>
#include <mutex>
#include <thread>

namespace rye::trainer {

struct RankWatch::State {
    std::mutex mutex;
    std::condition_variable done;
    bool over = false;
    std::thread thread;
};

RankWatch::RankWatch(Ranks& ranks, std::function<void(const std::string&)> act)
    : state_(std::make_unique<State>()) {
    state_->thread = std::thread([&s = *state_, &ranks, act = std::move(act)] {
        const std::chrono::milliseconds between(200);
        const std::chrono::seconds patience(10); // with the silence of a process below 30 s
        std::unique_lock<std::mutex> lock(s.mutex);
        const auto over = [&] { return s.over; };
        std::string reason;
        while (reason.empty()) {
            if (s.done.wait_for(lock, between, over)) return;
            lock.unlock();
            reason = ranks.ended();
            lock.lock();
        }
        // The act may hang as the rank itself does, in a library that waits for the one that ended.
        lock.unlock();
        std::thread acting(act, reason);
        lock.lock();
        if (s.done.wait_for(lock, patience, over)) {
            lock.unlock();
            acting.join();
            return;
        }
        std::cerr << "rye train: " << reason << std::endl;
        std::_Exit(1);
    });
}

RankWatch::~RankWatch() {
    {
        const std::lock_guard<std::mutex> lock(state_->mutex);
        state_->over = true;
    }
    state_->done.notify_all();
    state_->thread.join();
}

} // namespace rye::trainer
