// SPDX-License-Identifier: Apache-2.0
/// data/work_beside.hpp: one piece of work at a time in a thread beside the caller's, such as the
/// files of a training that goes on meanwhile.
#pragma once

#include <atomic>
#include <exception>
#include <functional>
#include <string>
#include <thread>
#include <utility>

namespace rye::trainer {

/// A piece of work on a thread of its own, one at a time. Its exception is thrown to the caller by
/// the next call of start() or wait(). Its inputs must stay as they are until one of these, or the
/// destructor, has returned.
class WorkBeside {
  public:
    /// `who` begins the warning of the destructor.
    explicit WorkBeside(std::string who) : who_(std::move(who)) {}
    WorkBeside(const WorkBeside&) = delete;
    WorkBeside& operator=(const WorkBeside&) = delete;
    /// Waits. An error that no call has thrown is a warning on standard error: the caller has one
    /// of its own under way.
    ~WorkBeside();

    /// Waits for the work before, then begins this; where the system has no thread left, does it.
    void start(std::function<void()> work);
    /// Returns when nothing is under way.
    void wait();
    /// Throws what the work has thrown, if it has ended; does not wait.
    void check();
    /// Seconds that start() and wait() have waited.
    double waited() const { return waited_; }

  private:
    void join();

    std::string who_;
    std::function<void()> work_;
    std::thread thread_;
    std::atomic<bool> ended_{false};
    std::exception_ptr error_; ///< of the thread until it is joined
    double waited_ = 0;
};

} // namespace rye::trainer
