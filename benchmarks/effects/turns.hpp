// SPDX-License-Identifier: Apache-2.0
/// benchmarks/effects/turns.hpp: two pieces of work that are timed in turns, each as often first as
/// second. The ratio is the median of those of neighbours: what slows the machine for a while slows
/// both. The least times of each would do on a machine at rest; on one that others use, none of the
/// longer pieces runs undisturbed, and two of the same were up to 12 % apart.
#pragma once

#include <algorithm>
#include <vector>

#include "../roofline/machine.hpp"

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
