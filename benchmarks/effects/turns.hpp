// SPDX-License-Identifier: Apache-2.0
/// benchmarks/effects/turns.hpp: alternating timing of two pieces of work, each as often first as
/// second. The ratio is the median of those of neighbours, as a temporary slowdown affects both.
/// Minimum times suffice on an idle machine; on a shared one no longer piece of work runs
/// undisturbed, and two equal ones differed by up to 12 %.
#pragma once

#include <algorithm>
#include <vector>

#include "../roofline/clock.hpp"

namespace rye::bench {

class Turns {
  public:
    template <class F, class G>
    void time(const F& with, const G& without) {
        const bool first = ratios_.size() % 2 == 0;
        double a = first ? least_time(1, with) : 0;
        const double b = least_time(1, without);
        if (!first) a = least_time(1, with);
        ratios_.push_back(a / b);
    }
    /// Time with over time without.
    double ratio() const {
        std::vector<double> r = ratios_;
        const auto middle = r.begin() + static_cast<std::ptrdiff_t>(r.size() / 2);
        std::nth_element(r.begin(), middle, r.end());
        return *middle;
    }

  private:
    std::vector<double> ratios_;
};

} // namespace rye::bench
