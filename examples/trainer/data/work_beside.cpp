// SPDX-License-Identifier: Apache-2.0
#include "data/work_beside.hpp"

#include <chrono>
#include <iostream>
#include <system_error>
#include <utility>

namespace rye::trainer {

WorkBeside::~WorkBeside() {
    join();
    if (!error_) return;
    try {
        std::rethrow_exception(error_);
    } catch (const std::exception& e) {
        std::cerr << who_ << ": warning: " << e.what() << "\n";
    } catch (...) {
        std::cerr << who_ << ": warning: an error without words\n";
    }
}

void WorkBeside::start(std::function<void()> work) {
    wait();
    work_ = std::move(work);
    ended_.store(false);
    try {
        thread_ = std::thread([this] {
            try {
                work_();
            } catch (...) {
                error_ = std::current_exception();
            }
            ended_.store(true);
        });
    } catch (const std::system_error&) {
        work_();
    }
}

void WorkBeside::wait() {
    join();
    if (error_) std::rethrow_exception(std::exchange(error_, nullptr));
}

void WorkBeside::check() {
    if (thread_.joinable() && ended_.load()) wait();
}

void WorkBeside::join() {
    if (!thread_.joinable()) return;
    const auto begin = std::chrono::steady_clock::now();
    thread_.join();
    waited_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

} // namespace rye::trainer
