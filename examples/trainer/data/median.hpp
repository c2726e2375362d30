// SPDX-License-Identifier: Apache-2.0
/// data/median.hpp: the median of a list.
#pragma once

#include <algorithm>
#include <cstddef>
#include <vector>

namespace rye::trainer {

/// Returns the middle number in order, the upper one of an even count; 0 for an empty list.
inline double median(std::vector<double> v) {
    if (v.empty()) return 0;
    const auto middle = v.begin() + static_cast<std::ptrdiff_t>(v.size() / 2);
    std::nth_element(v.begin(), middle, v.end());
    return *middle;
}

} // namespace rye::trainer
