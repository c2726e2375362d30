// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_sums.hpp: how a block of points passes the products of a network. Four warps, or
/// eight, have a quarter of a layer's columns each and all points of the block, or half of them.
/// Weights stream from the cache to registers, two steps ahead of the products, through the ends
/// of layers.
#pragma once

#include <rye/nn/cuda/mlp_operands.hpp>

namespace rye {

/// How blocks share the work: `points` a block, warps in `down` rows of four, `blocks` of a kernel
/// together; `early`: left operands are read a step ahead.
template <int points_, int down_, int blocks_, bool early_ = true>
struct MlpCut {
    static constexpr int points = points_, down = down_, blocks = blocks_;
    static constexpr bool early = early_;
};
/// ... of floats as N planes.
template <int N>
using MlpCutOf = MlpCut<N == 1 ? 64 : 32, N == 3 ? 2 : 1, N == 3 ? 1 : 2>;

/// Sizes of a block's work: widths at most `width`, inputs of points at most `inputs`, both
/// multiples of 32; floats as N planes.
template <int N_, int width_, int inputs_, class Cut = MlpCutOf<N_>>
struct MlpTiles {
    static constexpr int N = N_, width = width_, inputs = inputs_;
    static_assert(N >= 1 && N <= 3 && width % 32 == 0 && inputs % 32 == 0);
    static constexpr int points = Cut::points, down = Cut::down, blocks = Cut::blocks;
    static constexpr bool early = Cut::early;
    static constexpr int warps = 4 * down, threads = 32 * warps;
    static constexpr int high = points / (16 * down); ///< operands of 16 points a warp
    static constexpr int wide = (width > inputs ? width : inputs) / 32; ///< and of 8 columns
    static_assert(high >= 1 && points % (16 * down) == 0);

    /// Hidden numbers, then inputs, from column `width` on.
    using Layer = PlaneRows<N, points, width + inputs>;
    using Hidden = PlaneRows<N, points, width>;

    RYE_DEVICE static int first_row(int w) { return w / 4 * (points / down); }
    /// Tiles of 8 columns, of `tiles`, that warp w has: [first, first + own).
    RYE_DEVICE static int first(int w, int tiles) { return w % 4 * ((tiles + 3) / 4); }
    RYE_DEVICE static int own(int w, int tiles) {
        return rye::max(0, rye::min((tiles + 3) / 4, tiles - first(w, tiles)));
    }
};

/// A warp's sums, and the operands of its next two steps. K: a kernel, whose operand(i) is that of
/// its product number i of `products()`.
template <class W, class Tiles>
struct MlpSums {
    using F = typename W::F;
    using U = typename W::U;
    static constexpr int N = Tiles::N, high = Tiles::high, wide = Tiles::wide;
    Array<F, 4> sum[std::size_t(high)][std::size_t(wide)];

    /// Begins to fetch operands.
    template <class K>
    RYE_DEVICE void begin(const K& kernel, int w) {
        product_ = -1;
        left_ = 0;
        expanded<2>([&](auto slot) {
            if (left_ == 0) next_operand(kernel, w);
            expanded<wide>([&](auto n) { fetch(slot, n); });
            fetched();
        });
    }

    RYE_DEVICE void clear() {
        expanded<high>([&](auto m) {
            expanded<wide>([&](auto n) { expanded<4>([&](auto k) { sum[m][n][k] = F(0.0F); }); });
        });
    }
    /// Sums begin as biases of their columns.
    RYE_DEVICE void begin_with(const float* bias, int tiles, int w) {
        const int own = Tiles::own(w, tiles), first = Tiles::first(w, tiles);
        expanded<wide>([&](auto n) {
            if (n >= own) return;
            const auto b =
                W::read2(bias, U(static_cast<std::uint32_t>(4 * (first + n))) + W::lane() % U(4U));
            expanded<high>([&](auto m) { expanded<4>([&](auto k) { sum[m][n][k] = b[k % 2]; }); });
        });
    }

    /// += rows times the operand, which is the next of the kernel; column(k): where step k of its
    /// numbers along K begins.
    template <class K, class Rows, class Column>
    RYE_DEVICE void add(const K& kernel, const Rows& rows, const MlpOperand& operand, int w,
                        const Column& column) {
        const int own = Tiles::own(w, operand.tiles);
        const U place = Rows::left_place(W::lane(), Tiles::first_row(w));
        Left left[2];
        const auto read = [&](auto slot, int k) {
            expanded<high>(
                [&](auto m) { left[slot][m] = rows.template left<W>(place, 16 * m, column(k)); });
        };
        if (Tiles::early && operand.steps > 0) read(Constant<0>{}, 0);
        for (int k = 0; k < operand.steps; k += 2)
            expanded<2>([&](auto slot) {
                constexpr int other = Tiles::early ? 1 - decltype(slot)::value : 0,
                              own_left = Tiles::early ? decltype(slot)::value : 0;
                const int now = k + slot, next = Tiles::early ? now + 1 : now;
                if (now < operand.steps)
                    step<decltype(slot)::value>(kernel, left[own_left], own, w, [&] {
                        if (next < operand.steps) read(Constant<other>{}, next);
                    });
            });
        if (operand.steps % 2 == 1)
            expanded<wide>([&](auto n) {
                const Right first = right_[0][n];
                right_[0][n] = right_[1][n];
                right_[1][n] = first;
            });
    }

    /// of_row(r) of the warp's rows lane / 4 + r, then f(what it gave, n, a, b) of pairs of
    /// neighbours: columns 2 (lane % 4) of the warp's tile n and the next.
    template <class OfRow, class F2>
    RYE_DEVICE void each(int tiles, int w, const OfRow& of_row, const F2& f) const {
        const int own = Tiles::own(w, tiles);
        expanded<2 * high>([&](auto half) {
            constexpr int m = decltype(half)::value / 2, k = decltype(half)::value % 2 * 2;
            const auto row = of_row(Constant<8 * decltype(half)::value>{});
            expanded<wide>([&](auto n) {
                if (n < own) f(row, n, sum[m][n][k], sum[m][n][k + 1]);
            });
        });
    }
    /// Lane / 4 of the warp's first row, and 2 (lane % 4) of its first column.
    RYE_DEVICE static U first_row(int w) {
        return U(static_cast<std::uint32_t>(Tiles::first_row(w))) + W::lane() / U(4U);
    }
    RYE_DEVICE static U first_column(int w, int tiles) {
        return U(static_cast<std::uint32_t>(8 * Tiles::first(w, tiles))) +
               W::lane() % U(4U) * U(2U);
    }
    /// Two numbers as planes at a word of rows.
    template <class Rows>
    RYE_DEVICE static void put(Rows& rows, const U& word, F a, F b) {
        expanded<N>([&](auto p) {
            const U both = W::pack(a, b);
            W::write_word(&rows.at[p][0][0], word, both);
            a = a - W::low(both);
            b = b - W::high(both);
        });
    }

  private:
    using Right = Planes<W, N, 2>;
    struct Left {
        Planes<W, N, 4> of[std::size_t(high)];
        RYE_DEVICE Planes<W, N, 4>& operator[](int m) { return of[m]; }
    };
    Right right_[2][std::size_t(wide)];
    const std::uint32_t* at_; ///< of the next step that is fetched, the warp's first tile
    int product_, left_;      ///< product of the kernel, steps of it that are not fetched
    int own_, apart_;         ///< tiles that are the warp's, words from step to step

    template <class K>
    RYE_DEVICE void next_operand(const K& kernel, int w) {
        MlpOperand operand;
        while (operand.steps == 0 && product_ + 1 < kernel.products())
            operand = kernel.operand(++product_);
        at_ = operand.at + Index(Tiles::first(w, operand.tiles)) * (N * 64);
        own_ = Tiles::own(w, operand.tiles);
        apart_ = operand.tiles * (N * 64);
        left_ = operand.steps > 0 ? operand.steps : 1 << 30;
    }
    template <class Slot, class Tile>
    RYE_DEVICE void fetch(Slot slot, Tile n) {
        if (n < own_) right_[slot][n] = packed_tile<W, N>(at_ + n * (N * 64));
    }
    RYE_DEVICE void fetched() {
        at_ += apart_;
        --left_;
    }
    /// A step of 16 along K. Each tile of the operand, once it is used, is that of the next step
    /// but one.
    template <int slot, class K, class Ahead>
    RYE_DEVICE void step(const K& kernel, Left& left, int own, int w, const Ahead& ahead) {
        if (left_ == 0) next_operand(kernel, w);
        ahead();
        if (own == wide && own_ == wide)
            expanded<wide>([&](auto n) {
                expanded<high>(
                    [&](auto m) { multiply<W, N>(sum[m][n], left[m], right_[slot][n]); });
                right_[slot][n] = packed_tile<W, N>(at_ + n * (N * 64));
            });
        else
            expanded<wide>([&](auto n) {
                if (n < own)
                    expanded<high>(
                        [&](auto m) { multiply<W, N>(sum[m][n], left[m], right_[slot][n]); });
                fetch(Constant<slot>{}, n);
            });
        fetched();
    }
};

} // namespace rye
