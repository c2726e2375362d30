// SPDX-License-Identifier: Apache-2.0
/// rye/train/thread_group.hpp: ranks in threads of one process, whose numbers are in memory that
/// all of them see. A rank that ends by an exception ends the others where they next meet, with its
/// reason.
///     run_ranks(4, [&](ThreadGroup& group) { ... trainer.take(group) ... });
#pragma once

#include <condition_variable>
#include <exception>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <type_traits>
#include <vector>

#include <rye/train/group.hpp>

namespace rye {

/// The place where threads meet.
class ThreadMeeting {
  public:
    explicit ThreadMeeting(int size) : size_(size), shown_(static_cast<std::size_t>(size)) {
        require(size >= 1, "ThreadMeeting", "got ", size, " ranks, expected 1 or more");
    }
    int size() const { return size_; }

    /// Returns when all ranks have called it as often. Throws an Error with the reason if one has
    /// ended.
    void meet() {
        std::unique_lock<std::mutex> lock(mutex_);
        throw_if_ended();
        const std::size_t now = round_;
        if (++here_ == size_) {
            here_ = 0;
            ++round_;
            all_here_.notify_all();
            return;
        }
        all_here_.wait(lock, [&] { return round_ != now || failed_ || left_ >= 0; });
        if (round_ == now) throw_if_ended();
    }
    /// Says that a rank will not come again: those that still wait for it get an Error.
    void leave(int rank) {
        const std::lock_guard<std::mutex> lock(mutex_);
        if (left_ < 0) left_ = rank;
        all_here_.notify_all();
    }
    /// Ends the ranks that wait or will; keeps the first reason.
    void fail(int rank, const std::string& reason) {
        const std::lock_guard<std::mutex> lock(mutex_);
        if (!failed_)
            failed_ =
                std::make_unique<std::string>("rank " + std::to_string(rank) + " ended: " + reason);
        all_here_.notify_all();
    }
    /// Returns the reason if a rank has ended, else nothing.
    std::string failure() {
        const std::lock_guard<std::mutex> lock(mutex_);
        return failed_ ? *failed_ : std::string();
    }
    /// Shows the other ranks an address, to be read between two meetings.
    void show(int rank, const void* p) { shown_[static_cast<std::size_t>(rank)] = p; }
    template <class X>
    const X* shown(int rank) const {
        return static_cast<const X*>(shown_[static_cast<std::size_t>(rank)]);
    }

  private:
    void throw_if_ended() const {
        if (failed_) throw Error(*failed_);
        if (left_ >= 0)
            throw Error("rank " + std::to_string(left_) + " is done, while others wait for it");
    }

    int size_, here_ = 0;
    int left_ = -1; ///< first rank that is done
    std::size_t round_ = 0;
    std::mutex mutex_;
    std::condition_variable all_here_;
    std::unique_ptr<std::string> failed_;
    std::vector<const void*> shown_;
};

/// A thread's end of a group.
class ThreadGroup {
  public:
    /// The meeting must outlive it.
    ThreadGroup(ThreadMeeting& meeting, int rank) : meeting_(&meeting), rank_(rank) {}
    int rank() const { return rank_; }
    int size() const { return meeting_->size(); }
    void meet() { meeting_->meet(); }
    void fail(const std::string& reason) { meeting_->fail(rank_, reason); }
    std::string failure() { return meeting_->failure(); }

    /// Throws an Error if the ranks' arrays differ in number or size.
    template <class T>
    void sum(const detail::GroupArrays<T>& arrays) {
        const int n = size();
        meeting_->show(rank_, &arrays);
        meet();
        const auto of = [&](int rank) -> const detail::GroupArrays<T>& {
            return *meeting_->shown<detail::GroupArrays<T>>(rank);
        };
        std::string differs; // the same for every rank
        for (int r = 1; r < n && differs.empty(); ++r) {
            if (of(r).size() != of(0).size())
                differs = "rank " + std::to_string(r) + " has " + std::to_string(of(r).size()) +
                          " arrays, rank 0 has " + std::to_string(of(0).size());
            for (std::size_t k = 0; k < of(0).size() && differs.empty(); ++k)
                if (of(r)[k].size() != of(0)[k].size())
                    differs = "array " + std::to_string(k) + " of rank " + std::to_string(r) +
                              " has " + std::to_string(of(r)[k].size()) +
                              " numbers, that of rank 0 has " + std::to_string(of(0)[k].size());
        }
        if (!differs.empty()) {
            meet(); // the others still read this rank's arrays
            throw Error("ThreadGroup: " + differs);
        }
        std::vector<T> x(static_cast<std::size_t>(n));
        for (std::size_t k = 0; k < arrays.size(); ++k) {
            const StepShare part = share(static_cast<Index>(arrays[k].size()));
            for (Index i = part.first; i < part.first + part.count; ++i) {
                const auto at = static_cast<std::size_t>(i);
                for (int r = 0; r < n; ++r) x[static_cast<std::size_t>(r)] = of(r)[k][at];
                tree_sum(n, [&](int to, int from) {
                    x[static_cast<std::size_t>(to)] += x[static_cast<std::size_t>(from)];
                });
                for (int r = 0; r < n; ++r) of(r)[k][at] = x[0];
            }
        }
        meet();
    }
    /// Returns rank 0's value, for every rank.
    template <class X>
    X given(const X& own) {
        meeting_->show(rank_, &own);
        meet();
        const X value = *meeting_->shown<X>(0);
        meet();
        return value;
    }
    /// Returns true, for every rank, if it is true for any.
    bool any(bool own) {
        bool all = false;
        each_shown(&own, [&](int, const bool* theirs) { all = all || *theirs; });
        return all;
    }
    /// Calls f(rank, p) for what each rank shows with p, between two meetings.
    template <class X, class F>
    void each_shown(const X* own, const F& f) {
        meeting_->show(rank_, own);
        meet();
        for (int r = 0; r < size(); ++r) f(r, meeting_->shown<X>(r));
        meet();
    }

  private:
    /// Returns this rank's part of so many numbers.
    StepShare share(Index all) const {
        const Index first = all * rank_ / size();
        return {first, all * (rank_ + 1) / size() - first, all};
    }

    ThreadMeeting* meeting_;
    int rank_;
};
static_assert(Group<ThreadGroup>);

/// Calls f(group) on a thread for each rank, rank 0 on the caller's, and returns when all are done.
/// Throws what the first rank that ended by an exception threw.
template <class F>
void run_ranks(int size, const F& f) {
    ThreadMeeting meeting(size);
    std::mutex mutex;
    std::exception_ptr first;
    const auto run = [&](int rank) {
        ThreadGroup group(meeting, rank);
        const auto ended = [&](const std::string& reason) {
            {
                const std::lock_guard<std::mutex> lock(mutex);
                if (!first) first = std::current_exception();
            }
            group.fail(reason);
        };
        try {
            f(group);
            meeting.leave(rank);
        } catch (const std::exception& e) {
            ended(e.what());
        } catch (...) {
            ended("unknown");
        }
    };
    std::vector<std::thread> threads;
    for (int r = 1; r < size; ++r) threads.emplace_back(run, r);
    run(0);
    for (std::thread& t : threads) t.join();
    if (first) std::rethrow_exception(first);
}

} // namespace rye
