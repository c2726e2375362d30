// SPDX-License-Identifier: Apache-2.0
/// rye/train/probe.hpp: timing of a training step. A step calls its probe at the end of each part;
/// the default does nothing and costs nothing.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <map>
#include <string>
#include <vector>

#include <rye/core/config.hpp>

namespace rye {

/// Probe that measures nothing, at no cost.
struct NoProbe {
    void operator()(const char*) const {}
};

/// Probe that sums wall time by part. Keep one for many steps; call start() before each.
class TimeProbe {
  public:
    /// Time spent in a part, in all and by call.
    struct Part {
        double seconds = 0;
        Index calls = 0;
        std::vector<float> each = {}; ///< [s]

        /// Returns the median of its calls [s], which the first ones, often slower, hardly move.
        double median() const {
            if (each.empty()) return 0;
            std::vector<float> sorted = each;
            const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
            std::nth_element(sorted.begin(), middle, sorted.end());
            return static_cast<double>(*middle);
        }
    };
    void start() { last_ = std::chrono::steady_clock::now(); }
    void operator()(const char* part) {
        const auto now = std::chrono::steady_clock::now();
        Part& p = parts_[part];
        const double seconds = std::chrono::duration<double>(now - last_).count();
        p.seconds += seconds;
        p.each.push_back(static_cast<float>(seconds));
        ++p.calls;
        last_ = now;
    }
    const std::map<std::string, Part>& parts() const { return parts_; }

  private:
    std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
    std::map<std::string, Part> parts_;
};

} // namespace rye
