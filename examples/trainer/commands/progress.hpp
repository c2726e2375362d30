// SPDX-License-Identifier: Apache-2.0
/// commands/progress.hpp: the progress line of a training, and the time that is left of other work.
#pragma once

#include <chrono>
#include <string>
#include <vector>

#include <rye/core/columns.hpp>

namespace rye::trainer {

/// Returns a number of the progress line, by its name in log.jsonl.
std::string brief(const std::string& name, double value);

/// Returns minutes and seconds, as 3:05.
std::string clock_text(double seconds);

/// Returns ", 3:05 left" where `done` of `total` equal parts took these seconds; empty at the
/// beginning and the end.
std::string left_words(double seconds, Index done, Index total);

/// Progress line: rewritten in place on a terminal, printed now and then elsewhere. On a terminal,
/// losses beyond its width are omitted, the last ones first: a line that wraps could not be
/// rewritten. log.jsonl has all of them.
class Progress {
  public:
    Progress(std::string stage, Index total, bool quiet);

    /// Shows the progress after step number `step`, the last of `taken` steps taken together.
    void show(Index step, const std::vector<std::string>& losses, bool last, Index taken = 1);

  private:
    double seconds() const;

    std::string stage_;
    Index total_, first_step_ = -1;
    bool quiet_, tty_;
    std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
    double shown_ = -1e9;
};

} // namespace rye::trainer
