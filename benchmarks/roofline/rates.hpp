// SPDX-License-Identifier: Apache-2.0
/// benchmarks/roofline/rates.hpp: how many fused products of vectors a thread does a second and a
/// cycle, from short runs that alternate, and whether a processor can do that.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "clock.hpp"
#include "products.hpp"

namespace rye::bench {

/// Units of a core that take a fused product of a whole vector each cycle, at most.
#if defined(__x86_64__) || defined(__i386__)
inline constexpr double most_units = 2;
#else
inline constexpr double most_units = 4;  // of 128 bits
#endif

/// Wall times of one turn [s]: sums of integers, products of all chains, of one chain, sums again.
/// Each run is shorter than a scheduler's slice, so that most are undisturbed. The thread's clock
/// may show less than what passed, and the best of many runs would be those.
struct TurnTimes {
    static constexpr int rounds = 40000, sums = 640000;
    double before, all, one, after;
};

/// Runs one turn with vectors V.
template <class V>
TurnTimes turn() {
    constexpr int rounds = TurnTimes::rounds;
    const auto summed = [] {
        std::uint64_t x = dependent_sums(1, 3, TurnTimes::sums);
        opaque(x);
    };
    TurnTimes t{};
    fused_products<V>(rounds / 4);       // a core's widest units may take a while to wake up
    t.before = least_time(1, summed, wall_seconds);
    t.all = least_time(1, [] { fused_products<V>(rounds); }, wall_seconds);
    t.one = least_time(1, [] { fused_products<V, 1>(rounds); }, wall_seconds);
    t.after = least_time(1, summed, wall_seconds);
    return t;
}

/// The rates that turns with one kind of vector show.
///
/// A cycle is the time of one of a chain of sums of integers, on every processor known to us. The
/// frequency changes with load and with the width of vectors, so products are counted a cycle of
/// the sums right before and after them, in turns where both took the same time; half of those
/// turns show fewer, half more.
class ProductRates {
  public:
    explicit ProductRates(double lanes, int n = chains) : lanes_(lanes), chains_(n) {}
    /// Returns what `turns` of vectors V show.
    template <class V>
    static ProductRates measured(int turns) {
        ProductRates r{double(V::size)};
        for (int i = 0; i < turns; ++i) r.add(turn<V>());
        return r;
    }

    void add(const TurnTimes& t) {
        const double first = TurnTimes::sums / t.before, last = TurnTimes::sums / t.after;
        const double products = double(chains_) * TurnTimes::rounds / t.all;
        flops_ = std::max(flops_, 2 * lanes_ * products);
        cycles_ = std::max({cycles_, first, last});
        all_ = std::min(all_, t.all);
        one_ = std::min(one_, t.one);
        if (std::abs(first - last) < 0.02 * first) steady_.push_back(2 * products / (first + last));
    }

    double lanes() const { return lanes_; }
    /// Returns the most of all turns, a fused product counting as two [1/s]: other load and a core
    /// that has yet to speed up only lower it.
    double flops() const { return flops_; }
    /// Returns the highest frequency seen [1/s].
    double cycles() const { return cycles_; }
    /// Returns fused products of whole vectors a cycle: the units that take one each.
    double a_cycle() const {
        if (steady_.empty()) return 0;
        std::vector<double> x = steady_;
        const auto middle = x.begin() + static_cast<std::ptrdiff_t>(x.size() / 2);
        std::nth_element(x.begin(), middle, x.end());
        return *middle;
    }
    /// Returns how many products are under way at once: units times cycles that one takes. Needs no
    /// frequency.
    double under_way() const { return chains_ * one_ / all_; }
    /// Returns the cycles that a product takes.
    double latency() const { return under_way() / a_cycle(); }

    /// Says why these rates mean nothing, or "".
    std::string unmeasured() const {
        if (steady_.size() < 5) return "the frequency was steady in fewer than five turns";
        if (cycles_ < 1e8 || cycles_ > 1e10) return "sums of integers do not show the frequency";
        if (under_way() < 1.3) return "products do not overlap, as in an emulator";
        return "";
    }
    /// Says what no processor can do of these rates, or "".
    std::string impossible() const {
        if (under_way() > 0.95 * chains_) return "all chains take as long as one: they were merged";
        if (a_cycle() > 1.1 * most_units) return "more products a cycle than there are units";
        return "";
    }

  private:
    double lanes_;
    int chains_;
    double flops_ = 0, cycles_ = 0, all_ = 1e30, one_ = 1e30;
    std::vector<double> steady_;         // products a cycle
};

} // namespace rye::bench
