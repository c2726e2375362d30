// SPDX-License-Identifier: Apache-2.0
/// rye/nn/lanes/register_tile.hpp: accumulators of a small tile of a matrix product, in registers:
/// V vectors by P columns. Two multiply-add units of latency 4 need 8 to 12 accumulators.
#pragma once

#include <cstddef>
#include <utility>

#include <rye/core/config.hpp>

namespace rye::detail {

/// Accumulators of column P of a tile, one vector or two. Separate members, not an array, which gcc
/// would keep in memory.
template <class Batch, std::size_t V, std::size_t P>
struct TileColumn;
template <class Batch, std::size_t P>
struct TileColumn<Batch, 1, P> {
    Batch low = Batch(0);
    void add(const Batch& a, const Batch&, const Batch& b) {
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
    void add(const Batch& a0, const Batch& a1, const Batch& b) {
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

/// Accumulators of a tile of V vectors by the columns P....
template <class Batch, std::size_t V, class Columns>
struct RegisterTile;
template <class Batch, std::size_t V, std::size_t... P>
struct RegisterTile<Batch, V, std::index_sequence<P...>> : TileColumn<Batch, V, P>... {
    using T = typename Batch::value_type;

    /// sum += vectors at a, times the numbers at b, b + step, ....
    void add_product(const T* a, const T* b, Index step) {
        const Batch a0 = Batch::load_unaligned(a);
        const Batch a1 = Batch::load_unaligned(a + (V == 2 ? static_cast<Index>(Batch::size) : 0));
        (TileColumn<Batch, V, P>::add(a0, a1, Batch(b[static_cast<Index>(P) * step])), ...);
    }
    /// Calls f(where, sum, row of the tile), columns being `step` apart.
    template <class F>
    void each(T* to, Index step, const F& f) const {
        (TileColumn<Batch, V, P>::each(to + static_cast<Index>(P) * step, f), ...);
    }
};

} // namespace rye::detail
