// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_sums.hpp: how a block of points passes the products of a network. Warps share a
/// product's columns and points by its width. Weights stream from the cache to registers, two steps
/// ahead of the products; the first two steps of a product come while the one before is finished.
#pragma once

#include <type_traits>

#include <rye/nn/cuda/mlp_operands.hpp>

namespace rye {

namespace detail {

/// Shape of the work: `points` a block, warps in `down` rows of four, `blocks` of a kernel
/// together.
template <int points_, int down_, int blocks_>
struct MlpCut {
    static constexpr int points = points_, down = down_, blocks = blocks_;
};
/// ... of floats as N planes and widths of at most `width`: the fastest of those measured.
template <int N, int width = 256>
using MlpCutOf = std::conditional_t<N == 1 && width <= 128, MlpCut<64, 1, 4>,
                                    MlpCut<N == 1 ? 64 : 32, N == 2 ? 1 : 2, N == 3 ? 1 : 2>>;

/// A warp's part of a product: `high` operands of 16 points by `wide` ones of 8 columns, by warps
/// in rows of `across`.
template <int high_, int wide_, int across_>
struct MlpPart {
    static constexpr int high = high_, wide = wide_, across = across_;
    static constexpr int tiles = wide * across; ///< tiles of all warps
    RYE_DEVICE static int first_row(int w) { return w / across * (16 * high); }
    RYE_DEVICE static int first_tile(int w) { return w % across * wide; }
};

} // namespace detail

/// Sizes of a block's work: widths at most `width`, inputs of points at most `inputs`, both
/// multiples of 32; floats as N planes.
template <int N_, int width_, int inputs_, class Cut = detail::MlpCutOf<N_, width_>>
struct MlpTiles {
    static constexpr int N = N_, width = width_, inputs = inputs_;
    static_assert(N >= 1 && N <= 3 && width % 32 == 0 && inputs % 32 == 0);
    static constexpr int points = Cut::points, down = Cut::down, blocks = Cut::blocks;
    static constexpr int warps = 4 * down, threads = 32 * warps;
    static constexpr int high = points / (16 * down);
    static constexpr int wide = (width > inputs ? width : inputs) / 32;
    static_assert(high >= 1 && points % (16 * down) == 0 && (high <= 4 ? 4 % high : high % 4) == 0);

    using Full = detail::MlpPart<high, wide, 4>;
    using Half = detail::MlpPart<high, (wide + 1) / 2, 4>;
    /// The part for 32 columns: warps have fewer points and more columns each.
    using Narrow =
        detail::MlpPart<(high + 3) / 4, (high < 4 ? high : 4), (high < 4 ? 4 / high : 1)>;
    static constexpr bool has_narrow = wide >= 4, has_half = wide >= 2;

    /// Tiles that an operand of so many columns has, in whole parts of all warps.
    static int tiles(int columns) {
        if (has_narrow && columns <= 8 * Narrow::tiles) return Narrow::tiles;
        return has_half && columns <= 8 * Half::tiles ? Half::tiles : Full::tiles;
    }
    /// f(part) of an operand of so many tiles.
    template <class F>
    RYE_DEVICE static void with_part(int tiles, const F& f) {
        if constexpr (has_narrow)
            if (tiles == Narrow::tiles) return f(Narrow{});
        if constexpr (has_half)
            if (tiles == Half::tiles) return f(Half{});
        f(Full{});
    }

    /// Hidden numbers, then inputs, from column `width` on.
    using Layer = detail::PlaneRows<N, points, width + inputs>;
    using Hidden = detail::PlaneRows<N, points, width>;
};

namespace detail {

/// A warp's sums, and the operands of its next two steps.
template <class W, class Tiles>
struct MlpSums {
    using F = typename W::F;
    using U = typename W::U;
    static constexpr int N = Tiles::N, high = Tiles::high, wide = Tiles::wide;
    Array<F, 4> sum[std::size_t(high)][std::size_t(wide)];

    /// Starts to read the first two steps of an operand.
    RYE_DEVICE void begin(const MlpOperand& operand, int w) {
        Tiles::with_part(operand.tiles, [&](auto part) {
            const std::uint32_t* const at = first<decltype(part)>(operand, w);
            const int next = operand.steps > 1 ? operand.tiles * (N * 64) : 0;
            repeated<2>([&](auto slot) {
                repeated<part.wide>([&](auto n) {
                    right_[slot][n] = packed_tile<W, N>(at + slot * next + n * (N * 64));
                });
            });
        });
    }

    RYE_DEVICE void clear() {
        repeated<high>([&](auto m) {
            repeated<wide>([&](auto n) { repeated<4>([&](auto k) { sum[m][n][k] = F(0.0F); }); });
        });
    }
    /// Sums begin as biases of their columns, of which there are so many.
    template <class Part>
    RYE_DEVICE void begin_with(Part part, const float* bias, int columns, int w) {
        const U end(static_cast<std::uint32_t>(columns / 2));
        repeated<part.wide>([&](auto n) {
            const U pair =
                U(static_cast<std::uint32_t>(4 * (Part::first_tile(w) + n))) + W::lane() % U(4U);
            const auto b = W::read2_where(pair < end, bias, pair);
            repeated<part.high>(
                [&](auto m) { repeated<4>([&](auto k) { sum[m][n][k] = b[k % 2]; }); });
        });
    }

    /// += rows times an operand that has begun; column(k): where step k of its numbers along K
    /// begins.
    template <class Part, class Rows, class Column>
    RYE_DEVICE void add(Part part, const Rows& rows, const MlpOperand& operand, int w,
                        const Column& column) {
        const U place = Rows::left_place(W::lane(), Part::first_row(w));
        const int apart = Part::tiles * (N * 64), steps = operand.steps;
        const std::uint32_t* at =
            first<Part>(operand, w) + 2 * apart; ///< the step that is read next
        const auto step = [&](auto slot, int k) {
            Planes<W, N, 4> left[std::size_t(Part::high)];
            repeated<part.high>(
                [&](auto m) { left[m] = rows.template left<W>(place, 16 * m, column(k)); });
            const bool more = k + 2 < steps;
            repeated<part.wide>([&](auto n) {
                repeated<part.high>(
                    [&](auto m) { multiply<W, N>(sum[m][n], left[m], right_[slot][n]); });
                if (more) right_[slot][n] = packed_tile<W, N>(at + n * (N * 64));
            });
            at += apart;
        };
        int k = 0;
        for (; k + 1 < steps; k += 2) {
            step(Constant<0>{}, k);
            step(Constant<1>{}, k + 1);
        }
        if (k < steps) step(Constant<0>{}, k);
    }

    /// of_row(r) of the warp's rows lane / 4 + r, then f(what it gave, n, a, b) of pairs of
    /// neighbours: columns 2 (lane % 4) of the warp's tile n and the next.
    template <class Part, class OfRow, class F2>
    RYE_DEVICE void each(Part part, const OfRow& of_row, const F2& f) const {
        expanded<2 * part.high>([&](auto half) {
            constexpr int m = decltype(half)::value / 2, k = decltype(half)::value % 2 * 2;
            const auto row = of_row(Constant<8 * decltype(half)::value>{});
            repeated<part.wide>([&](auto n) { f(row, n, sum[m][n][k], sum[m][n][k + 1]); });
        });
    }
    /// Lane / 4 of the warp's first row, and 2 (lane % 4) of its first column.
    template <class Part>
    RYE_DEVICE static U first_row(Part, int w) {
        return U(static_cast<std::uint32_t>(Part::first_row(w))) + W::lane() / U(4U);
    }
    template <class Part>
    RYE_DEVICE static U first_column(Part, int w) {
        return U(static_cast<std::uint32_t>(8 * Part::first_tile(w))) + W::lane() % U(4U) * U(2U);
    }
    /// f(word, n, a, b) of pairs, with their word in rows of planes, as far as the layers' width.
    template <class Part, class Rows, class F2>
    RYE_DEVICE void each_word(Part part, const Rows&, int w, const F2& f) const {
        constexpr int words = Rows::stride / 2;
        const U first =
            first_row(part, w) * U(std::uint32_t(words)) + first_column(part, w) / U(2U);
        each(
            part, [&](auto row) { return U(first + U(std::uint32_t(row * words))); },
            [&](const U& of_row, auto n, const F& a, const F& b) {
                if (8 * Part::tiles <= Tiles::width || 8 * (Part::first_tile(w) + n) < Tiles::width)
                    f(U(of_row + U(std::uint32_t(4 * n))), a, b);
            });
    }
    /// Two numbers as planes at a word of rows.
    template <class Rows>
    RYE_DEVICE static void put(Rows& rows, const U& word, F a, F b) {
        repeated<N>([&](auto p) {
            const U both = W::pack(a, b);
            W::write_word(&rows.at[p][0][0], word, both);
            a = a - W::low(both);
            b = b - W::high(both);
        });
    }

  private:
    Planes<W, N, 2> right_[2][std::size_t(wide)]; ///< operands of the next two steps

    template <class Part>
    RYE_DEVICE static const std::uint32_t* first(const MlpOperand& operand, int w) {
        return operand.at + Part::first_tile(w) * (N * 64);
    }
};

} // namespace detail

} // namespace rye
