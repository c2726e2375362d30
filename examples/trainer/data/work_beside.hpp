// SPDX-License-Identifier: Apache-2.0
/// data/work_beside.hpp: background work, one job at a time, such as writing a training's files
/// while it continues.
#pragma once

#include <atomic>
#include <exception>
#include <functional>
#include <string>
#include <thread>
#include <utility>

namespace rye::trainer {

/// Thread that runs one job at a time. The next call of start() or wait() throws a job's exception
/// to the caller. A job's inputs must not change until one of these calls, or the destructor,
/// returns.
class WorkBeside {
  public:
    /// `who` begins the warning of the destructor.
    explicit WorkBeside(std::string who) : who_(std::move(who)) {}
    WorkBeside(const WorkBeside&) = delete;
    WorkBeside& operator=(const WorkBeside&) = delete;
    /// Waits. Prints an error that no call has thrown as a warning: the caller has one of its own
    /// under way.
    ~WorkBeside();

    /// Waits for the previous job, then starts this one; runs it at once if the system has no
    /// thread left.
    void start(std::function<void()> work);
    /// Waits until no job is running.
    void wait();
    /// Throws the exception of a job that has ended; does not wait.
    void check();
    /// Returns the time that start() and wait() have waited [s].
    double waited() const { return waited_; }

  private:
    void join();

    std::string who_;
    std::function<void()> work_;
    std::thread thread_;
    std::atomic<bool> ended_{false};
    std::exception_ptr error_; ///< exception of the thread, until it is joined
    double waited_ = 0;
};

} // namespace rye::trainer
