// SPDX-License-Identifier: Apache-2.0
/// benchmarks/roofline/load.hpp: which processor this is, and what else it does while something is
/// measured.
#pragma once

#include <fstream>
#include <string>

namespace rye::bench {

/// Reads the processor's name from Linux's file; "unknown" without one.
inline std::string processor_name(const std::string& file = "/proc/cpuinfo") {
    std::ifstream in(file);
    for (std::string line; std::getline(in, line);) {
        const std::size_t colon = line.find(':');
        if (line.rfind("model name", 0) != 0 || colon == std::string::npos) continue;
        const std::size_t begin = line.find_first_not_of(" \t", colon + 1);
        if (begin != std::string::npos) return line.substr(begin);
    }
    return "unknown";
}

/// The system's load at one moment, as it says itself; -1 where it says nothing.
struct Load {
    double average = -1;                 ///< processes that run or wait, over the last minute
    double running = -1;                 ///< the same now, this one included

    static Load now(const std::string& file = "/proc/loadavg") {
        std::ifstream in(file);
        Load r;
        double five = 0, fifteen = 0;
        if (!(in >> r.average >> five >> fifteen >> r.running)) return {};
        return r;
    }
};

/// The mean of what was seen beside a measurement: look() once a round.
class LoadSeen {
  public:
    void look() {
        const Load l = Load::now();
        sum_.average += l.average;
        sum_.running += l.running;
        ++n_;
    }
    Load mean() const { return {sum_.average / n_, sum_.running / n_}; }

  private:
    Load sum_{0, 0};
    int n_ = 0;
};

} // namespace rye::bench
