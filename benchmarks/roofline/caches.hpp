// SPDX-License-Identifier: Apache-2.0
/// benchmarks/roofline/caches.hpp: how much the data caches of a core hold, and what is worth
/// measuring of them.
#pragma once

#include <algorithm>
#include <fstream>
#include <string>
#include <vector>

#include <unistd.h>

namespace rye::bench {

/// Reads what a file of the system states as "48K", "32M" or "1G" [byte]; 0 if it is no such text.
inline double stated_bytes(const std::string& text) {
    std::size_t end = 0;
    double n = 0;
    for (; end < text.size() && text[end] >= '0' && text[end] <= '9'; ++end)
        n = 10 * n + (text[end] - '0');
    const std::string unit = text.substr(end);
    return n * (unit.empty()  ? 1
                : unit == "K" ? 0x1p10
                : unit == "M" ? 0x1p20
                : unit == "G" ? 0x1p30
                              : 0);
}

/// Lists how much each level holds [byte], from the first to the last, each more than the one
/// before: by Linux's files in `folder`, else as the C library says, else what is usual. In a
/// virtual machine the last level may be that of the whole host, shared with others.
inline std::vector<double> cache_sizes(
    const std::string& folder = "/sys/devices/system/cpu/cpu0/cache") {
    std::vector<double> found;
    for (int i = 0; i < 16; ++i) {
        const std::string index = folder + "/index" + std::to_string(i) + "/";
        std::string type, size;
        if (!(std::ifstream(index + "type") >> type) || !(std::ifstream(index + "size") >> size))
            break;
        if (type != "Instruction") found.push_back(stated_bytes(size));
    }
#if defined(_SC_LEVEL1_DCACHE_SIZE)
    if (found.empty())
        for (const int name :
             {_SC_LEVEL1_DCACHE_SIZE, _SC_LEVEL2_CACHE_SIZE, _SC_LEVEL3_CACHE_SIZE})
            found.push_back(static_cast<double>(sysconf(name)));
#endif
    std::sort(found.begin(), found.end());
    found.erase(found.begin(),
                std::find_if(found.begin(), found.end(), [](double b) { return b >= 4096; }));
    found.erase(std::unique(found.begin(), found.end()), found.end());
    return found.empty() ? std::vector<double>{0x1p15, 0x1p20, 0x1p23} : found;
}

/// A size at which memory is measured, and the work that its speed holds for.
struct WorkingSet {
    std::string level;                   ///< "L1" and so on, or "memory"
    double bytes;                        ///< of the arrays that are gone through
    double holds;                        ///< the most that work may touch [byte]
};

/// Chooses half of what a level holds; of one of more than 16 MiB, whose speed falls with the
/// distance and which others may share, also 8 MiB, 32 MiB and so on; of memory four times the last
/// level, where that is no more than `most`.
inline std::vector<WorkingSet> working_sets(const std::vector<double>& caches, double most) {
    std::vector<WorkingSet> sets;
    for (std::size_t i = 0; i < caches.size(); ++i) {
        std::string level = "L";
        level += std::to_string(i + 1);
        if (i + 1 == caches.size())
            for (double holds = 0x1p24; holds < caches[i] / 2; holds *= 4)
                if (i == 0 || holds > 2 * caches[i - 1])
                    sets.push_back({level, holds / 2, holds});
        sets.push_back({level, caches[i] / 2, caches[i]});
    }
    std::erase_if(sets, [&](const WorkingSet& s) { return s.bytes > most; });
    sets.push_back({"memory", std::min(most, 4 * caches.back()), 1e30});
    return sets;
}

} // namespace rye::bench
