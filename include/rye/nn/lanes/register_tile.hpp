// SPDX-License-Identifier: Apache-2.0
/// rye/nn/lanes/register_tile.hpp: the sums of a small tile of a matrix product, kept in registers:
/// V vectors by P columns. 8 to 12 sums are what two multiply-add units of latency 4 need.
#pragma once

#include <cstddef>
#include <utility>

#include <rye/core/config.hpp>

namespace rye::detail {

template <class A>
struct SumOfFactor {
    using type = A;
};
template <class A>
    requires requires { typename A::sum_type; }
struct SumOfFactor<A> {
    using type = typename A::sum_type;
};
template <class A>
using SumOf = typename SumOfFactor<A>::type;

/// The sums of column P of a tile: one vector, or two. Members of their own, not of an array, which
/// gcc would keep in memory.
template <class Batch, std::size_t V, std::size_t P>
struct TileColumn;
template <class Batch, std::size_t P>
struct TileColumn<Batch, 1, P> {
    Batch low = Batch(0);
    template <class A>
    void add(const A& a, const A&, const A& b) {
        low = fma(a, b, low);
    }
    template <class F>
    void each(typename Batch::value_type* to, const F& f) const {
        f(to, low, 0);
    }
};
template <class Batch, std::size_t P>
struct TileColumn<Batch, 2, P> {
    Batch low = Batch(0), high = Batch(0);
    template <class A>
    void add(const A& a0, const A& a1, const A& b) {
        low = fma(a0, b, low);
        high = fma(a1, b, high);
    }
    template <class F>
    void each(typename Batch::value_type* to, const F& f) const {
        constexpr Index lanes = static_cast<Index>(Batch::size);
        f(to, low, 0);
        f(to + lanes, high, lanes);
    }
};

/// The sums of a tile of V vectors by the columns P.... Factors are vectors like the sums, or what
/// A::sum_type names its sums.
template <class A, std::size_t V, class Columns>
struct RegisterTile;
template <class A, std::size_t V, std::size_t... P>
struct RegisterTile<A, V, std::index_sequence<P...>> : TileColumn<SumOf<A>, V, P>... {
    using Batch = SumOf<A>;
    using T = typename Batch::value_type;
    using Factor = typename A::value_type;

    /// sum += vectors at a, times the numbers at b that are `step` apart.
    void add_product(const Factor* a, const Factor* b, Index step) {
        const A a0 = A::load_unaligned(a);
        const A a1 = A::load_unaligned(a + (V == 2 ? static_cast<Index>(Batch::size) : 0));
        (TileColumn<Batch, V, P>::add(a0, a1, A(b[static_cast<Index>(P) * step])), ...);
    }
    /// f(where, sum, row of the tile) with the columns `step` apart.
    template <class F>
    void each(T* to, Index step, const F& f) const {
        (TileColumn<Batch, V, P>::each(to + static_cast<Index>(P) * step, f), ...);
    }
};

} // namespace rye::detail
