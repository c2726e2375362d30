// SPDX-License-Identifier: Apache-2.0
/// model/ranks.hpp: ranks that train one run together, as the program has them: threads of one
/// process, or processes that a launcher starts, one a device. Rank 0 trains stage 1 and writes the
/// run's folder.
#pragma once

#include <string>

#include <rye/train/thread_group.hpp>

namespace rye::trainer {

/// A rank's end of the group.
class Ranks {
  public:
    virtual ~Ranks() = default;
    virtual int rank() const = 0;
    virtual int size() const = 0;
    /// Returns rank 0's words to every rank, each of which calls it; waits for rank 0. Throws an
    /// Error if another rank has ended.
    virtual std::string given(const std::string& own) = 0;
    /// Returns the reason if another rank has ended, else nothing; for any thread.
    virtual std::string ended() = 0;
    /// Returns the group of ranks that share memory, else null.
    virtual ThreadGroup* threads() { return nullptr; }
};

/// Returns true for one rank alone (null), and for rank 0.
inline bool first_of(const Ranks* ranks) { return ranks == nullptr || ranks->rank() == 0; }

/// Ranks in threads of this process.
class RanksInThreads final : public Ranks {
  public:
    explicit RanksInThreads(const ThreadGroup& group) : group_(group) {}
    int rank() const override { return group_.rank(); }
    int size() const override { return group_.size(); }
    std::string given(const std::string& own) override { return group_.given(own); }
    std::string ended() override { return group_.failure(); }
    ThreadGroup* threads() override { return &group_; }

  private:
    ThreadGroup group_;
};

} // namespace rye::trainer
