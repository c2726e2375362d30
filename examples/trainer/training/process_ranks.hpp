// SPDX-License-Identifier: Apache-2.0
/// training/process_ranks.hpp: ranks in processes, on one machine or several that see the run's
/// folder, started by a launcher. They meet in its folder ranks/, by files that each names after a
/// number that rank 0 draws, so that those of an earlier start mean nothing. A rank that ends
/// leaves its reason there; one that is killed gives no signs of life any more.
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "model/ranks.hpp"

namespace rye::trainer {

/// Place of a process among those that a launcher started.
struct LaunchedRank {
    int rank = 0, size = 1;
    int local = 0; ///< among those of its machine
};

/// Returns true for the name of a launcher: torchrun, mpi or slurm.
bool is_launcher(const std::string& name);

/// Returns a number of ranks in one process. Throws an Error for one that is none.
int parsed_ranks(const std::string& text, const std::string& who);

/// Returns what a launcher's variables of the environment say of this process. Throws an Error that
/// names a variable which is missing or no number.
LaunchedRank launched_by(const std::string& launcher);

/// Times of the ranks' files [s].
struct RankTimes {
    double sign = 2;      ///< between a rank's signs of life
    double patience = 10; ///< without a sign after which a rank has ended
    double arrival = 300; ///< for all ranks to come
};

/// Ranks in processes.
class RanksInProcesses final : public Ranks {
  public:
    /// Waits until all ranks are there. Throws an Error if some have not come in time, and names
    /// them.
    RanksInProcesses(const std::filesystem::path& run, const LaunchedRank& place,
                     const RankTimes& times = {});
    /// Tells the others that this rank is done. Rank 0 waits for them and removes the files.
    ~RanksInProcesses() override;

    int rank() const override;
    int size() const override;
    std::string given(const std::string& own) override;
    std::string ended() override;
    /// Tells the others why this rank ends.
    void leave(const std::string& reason) noexcept;

  private:
    struct Meeting;
    std::unique_ptr<Meeting> meeting_;
};

} // namespace rye::trainer
