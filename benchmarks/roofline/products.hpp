// SPDX-License-Identifier: Apache-2.0
/// benchmarks/roofline/products.hpp: how many fused products of lanes a thread does at most, and
/// its core's frequency, which says how many that is a cycle.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <utility>

#include <rye/backend/lanes.hpp>

#include "clock.hpp"

namespace rye::bench {

/// Products that do not wait for each other. A chain's next product waits for the last one's 3 to 5
/// cycles, and 2 to 4 units take one each a cycle, so 8 to 16 chains fill them; each chain has a
/// register of its own, and two registers hold the factors.
#if defined(__AVX512F__) || defined(__aarch64__)
inline constexpr int chains = 24;        // of 32 registers
#else
inline constexpr int chains = 12;        // of 16
#endif

/// Where the chains of products begin, a vector each, or where they end.
struct ChainValues {
    using V = XsimdBackend<>::batch<float>;
    static constexpr std::size_t lanes = V::size;
    alignas(64) std::array<float, std::size_t(chains) * lanes> value;

    /// Makes different numbers, from 0.5 on.
    static ChainValues different() {
        ChainValues r;
        for (std::size_t i = 0; i < r.value.size(); ++i)
            r.value[i] = 0.5F + 0x1p-9F * static_cast<float>(i);
        return r;
    }
};

/// Calls f(0) ... f(chains - 1) with constants, so that arrays indexed by them stay in registers.
template <class F>
[[gnu::always_inline]] inline void each_chain(const F& f) {
    [&]<std::size_t... I>(std::index_sequence<I...>) __attribute__((always_inline)) {
        (f(std::integral_constant<std::size_t, I>()), ...);
    }(std::make_index_sequence<std::size_t(chains)>());
}

/// A product's factor and what is added to it: a = a x + y.
struct ChainStep {
    float x = 0.999F, y = 1e-3F;
};

/// Takes `rounds` products of each chain. The compiler must know neither where they begin nor that
/// they differ: it computes chains of equal values once. So it learns nothing from the caller, and
/// all ends are stored.
[[gnu::noinline]] inline void run_chains(const ChainValues* from, const ChainStep* step, int rounds,
                                         ChainValues* to) {
    using V = ChainValues::V;
    opaque(from);
    opaque(step);
    std::array<V, std::size_t(chains)> a;
    each_chain([&](auto i) __attribute__((always_inline)) {
        a[i] = V::load_aligned(from->value.data() + i * ChainValues::lanes);
    });
    const V x(step->x), y(step->y);
    for (int round = 0; round < rounds; ++round)
        each_chain([&](auto i) __attribute__((always_inline)) { a[i] = fma(a[i], x, y); });
    each_chain([&](auto i) __attribute__((always_inline)) {
        a[i].store_aligned(to->value.data() + i * ChainValues::lanes);
    });
}

/// Runs the chains for their time alone.
inline void fused_products(int rounds) {
    const ChainValues from = ChainValues::different();
    const ChainStep step;
    ChainValues to;
    run_chains(&from, &step, rounds, &to);
    opaque(to);
}

/// Adds `sums` times, a multiple of 64, where each sum waits for the one before. The addend is in a
/// register: some processors add constants without a cycle.
[[gnu::noinline]] inline std::uint64_t dependent_sums(std::uint64_t x, std::uint64_t addend,
                                                      int sums) {
    for (int i = 0; i < sums; i += 64) {
#pragma GCC unroll 64
        for (int k = 0; k < 64; ++k) {
            x += addend;
            asm volatile("" : "+r"(x), "+r"(addend));
        }
    }
    return x;
}

/// The peak rate and the frequency, measured in short runs that alternate; the best of all turns
/// counts, since other load and a core that has yet to speed up only lower them.
/// The frequency is that of a chain of sums of integers, one a cycle on every processor known to
/// us, on the clock of the thread. It has limits: a core may slow down for wide vectors, which then
/// do less a cycle of this frequency than they could; a hypervisor that stops the core in every run
/// lowers both; an emulator's cycles mean nothing.
struct PeakTurns {
    static constexpr int rounds = 40000, sums = 640000;
    double flops = 0;                    ///< float, a fused product counting as two [1/s]
    double cycles = 0;                   ///< [1/s]

    void turn() {
        const double summed = least_time(1, [] {
            std::uint64_t x = dependent_sums(1, 3, sums);
            opaque(x);
        });
        const double multiplied = least_time(1, [] { fused_products(rounds); });
        cycles = std::max(cycles, sums / summed);
        flops = std::max(flops, 2.0 * rounds * chains * double(ChainValues::lanes) / multiplied);
    }
    /// Counts fused products of whole vectors a cycle: the units that take one each.
    double products_a_cycle() const { return flops / (2 * double(ChainValues::lanes) * cycles); }
};

} // namespace rye::bench
