// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_kernels.hpp: a block of points through all layers of a network, forward and
/// back, with what passes from layer to layer in shared memory. Four warps, or eight, have a
/// quarter of a layer's columns each and all points of the block, or half of them. Weights stream
/// from the cache to registers, two steps ahead of the products, through the ends of layers.
#pragma once

#include <rye/nn/activations.hpp>
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
using MlpCutOf =
    std::conditional_t<N == 1, MlpCut<64, 1, 2>, MlpCut<N == 2 ? 64 : 32, 2, 1>>;

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
            const auto b = W::read2(bias, U(static_cast<std::uint32_t>(4 * (first + n))) +
                                              W::lane() % U(4U));
            expanded<high>([&](auto m) {
                expanded<4>([&](auto k) { sum[m][n][k] = b[k % 2]; });
            });
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
        return U(static_cast<std::uint32_t>(8 * Tiles::first(w, tiles))) + W::lane() % U(4U) * U(2U);
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

/// All layers of a network, forward, for a block of points.
template <class Tiles, class A>
struct MlpForwardKernel {
    static constexpr const char* name = "network, forward";
    static constexpr int threads = Tiles::threads, blocks = Tiles::blocks;
    using Rows = typename Tiles::Layer;
    using Shared = Rows;
    DeviceMlpNetwork network;
    DeviceColumns<const float> points; ///< inputs x N
    DeviceColumns<float> out;          ///< outputs x N
    bool keep;                         ///< what a vjp reads

    RYE_DEVICE int products() const { return network.layers; }
    RYE_DEVICE const MlpOperand& operand(int i) const { return network.layer[i].to_out; }

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& rows) const {
        using W = typename Block::Warp;
        constexpr int warps = Tiles::warps, width = Tiles::width;
        const auto first = static_cast<std::uint32_t>(block.index()) * Tiles::points;
        const std::uint32_t count = network.of.among(network.points);
        if (first >= count) return;
        const int inputs = padded_16(network.inputs);
        auto sums = block.template of_warps<MlpSums<W, Tiles>>();
        block.each_warp([&](int w) {
            sums[w].begin(*this, w);
            rows.template load<W, warps>(PointRows{points, count, network.of.which}, first, width,
                                         inputs, w);
        });
        for (int l = 0; l < network.layers; ++l) {
            const DeviceMlpLayer& layer = network.layer[l];
            const int hidden = padded_16(layer.hidden);
            const bool last = l + 1 == network.layers;
            block.each_warp([&](int w) {
                sums[w].begin_with(layer.bias, layer.to_out.tiles, w);
                if (keep)
                    rows.template store<W, warps>(
                        l == 0 ? network.input : network.layer[l - 1].activated, first,
                        network.points, l == 0 ? width : 0, l == 0 ? inputs : hidden, w);
                sums[w].add(*this, rows, layer.to_out, w, [&](int k) {
                    return 16 * k < hidden ? 16 * k : 16 * k - hidden + width;
                });
                if (last) finish(sums[w], layer, {first, count}, w);
            });
            if (!last)
                block.each_warp([&](int w) { activate<W>(rows, sums[w], layer.to_out.tiles, w); });
        }
    }

  private:
    struct Range {
        std::uint32_t first, end; ///< points
    };
    /// Columns beyond the layer's are those of a sum of 0: weights of 0 take them on.
    template <class W>
    RYE_DEVICE static void activate(Rows& rows, const MlpSums<W, Tiles>& sums, int tiles, int w) {
        using F = typename W::F;
        using U = typename W::U;
        using Sums = MlpSums<W, Tiles>;
        constexpr int words = Rows::stride / 2;
        const U word = Sums::first_row(w) * U(std::uint32_t(words)) +
                       Sums::first_column(w, tiles) / U(2U);
        sums.each(
            tiles, w, [&](auto row) { return U(word + U(std::uint32_t(row * words))); },
            [&](const U& of_row, auto n, const F& a, const F& b) {
                Sums::put(rows, of_row + U(std::uint32_t(4 * n)), F(A::value(a)), F(A::value(b)));
            });
    }
    template <class W>
    RYE_DEVICE void finish(const MlpSums<W, Tiles>& sums, const DeviceMlpLayer& layer,
                           const Range& of, int w) const {
        using F = typename W::F;
        using U = typename W::U;
        using Sums = MlpSums<W, Tiles>;
        const int tiles = layer.to_out.tiles;
        const U rows(static_cast<std::uint32_t>(layer.out));
        const U column = Sums::first_column(w, tiles);
        const U first = U(of.first) + Sums::first_row(w);
        const auto each = [&](const auto& write) {
            sums.each(
                tiles, w, [&](auto row) { return U(first + U(std::uint32_t(row))); },
                [&](const U& point, auto n, const F& a, const F& b) {
                    const U c = column + U(std::uint32_t(8 * n));
                    write(point < U(of.end) && c < rows, point * rows + c, c, a, b);
                });
        };
        if (layer.out % 2 == 0)
            each([&](const auto& there, const U& at, const U&, const F& a, const F& b) {
                W::write2_where(there, out.data, at / U(2U), a, b);
            });
        else
            each([&](const auto& there, const U& at, const U& c, const F& a, const F& b) {
                W::write_where(there, out.data, at, a);
                W::write_where(there && c + U(1U) < rows, out.data, at + U(1U), b);
            });
    }
};

/// Cotangents of the outputs of all layers, for the weights' gradients, and of the inputs.
template <class Tiles, class A>
struct MlpReverseKernel {
    static constexpr const char* name = "network, reverse";
    static constexpr int threads = Tiles::threads, blocks = Tiles::blocks;
    using Rows = typename Tiles::Hidden;
    struct Shared {
        Rows cotangent, below; ///< of a layer's outputs; outputs of the layer below
    };
    DeviceMlpNetwork network;
    DeviceColumns<const float> g_out; ///< outputs x N
    DeviceColumns<float> g_points;    ///< inputs x N, at the points' columns, or null
    bool add;                         ///< to g_points

    /// From the last layer on, to its input and to the layer below.
    RYE_DEVICE int products() const { return 2 * network.layers; }
    RYE_DEVICE MlpOperand operand(int i) const {
        const DeviceMlpLayer& layer = network.layer[network.layers - 1 - i / 2];
        if (i % 2 == 1) return layer.out_to_hidden;
        return g_points.data != nullptr ? layer.out_to_input : MlpOperand{};
    }

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        constexpr int warps = Tiles::warps;
        // From the last points on, whose numbers the forward pass has left in the cache.
        const std::uint32_t first =
            ((network.points - 1) / Tiles::points - static_cast<std::uint32_t>(block.index())) *
            Tiles::points;
        const std::uint32_t count = network.of.among(network.points);
        if (first >= count) return;
        auto sums = block.template of_warps<MlpSums<W, Tiles>>();
        block.each_warp([&](int w) {
            sums[w].begin(*this, w);
            shared.cotangent.template load<W, warps>(PointRows{g_out, count}, first, 0,
                                                     padded_16(static_cast<int>(g_out.rows)), w);
        });
        bool again = add; // a layer above has written g_points
        for (int l = network.layers - 1; l >= 0; --l) {
            const DeviceMlpLayer& layer = network.layer[l];
            const int hidden = padded_16(layer.hidden);
            const bool to_input = layer.takes_input && g_points.data != nullptr;
            const auto column = [](int k) { return 16 * k; };
            block.each_warp([&](int w) {
                if (hidden > 0)
                    shared.below.template fetch<W, warps>(network.layer[l - 1].activated, first,
                                                          network.points, hidden, w);
                W::end_copies();
                shared.cotangent.template store<W, warps>(layer.cotangent, first, network.points, 0,
                                                          padded_16(layer.out), w);
                for (int part = to_input ? 0 : 1; part < (hidden > 0 ? 2 : 1); ++part) {
                    sums[w].clear();
                    sums[w].add(*this, shared.cotangent,
                                part == 0 ? layer.out_to_input : layer.out_to_hidden, w, column);
                    if (part == 0) to_points(sums[w], {first, count}, w, again);
                }
                W::template wait_for_copies<0>();
            });
            again = again || to_input;
            if (hidden > 0)
                block.each_warp(
                    [&](int w) { through<W>(shared, sums[w], layer.out_to_hidden.tiles, w); });
        }
    }

  private:
    static constexpr std::uint32_t nowhere = 0xFFFFFFFFU; ///< numbers of all points are fewer
    struct Range {
        std::uint32_t first, end; ///< points
    };
    template <class W>
    RYE_DEVICE void to_points(const MlpSums<W, Tiles>& sums, const Range& of, int w,
                              bool again) const {
        using F = typename W::F;
        using U = typename W::U;
        using Sums = MlpSums<W, Tiles>;
        const int tiles = padded_16(network.inputs) / 8;
        const U rows(static_cast<std::uint32_t>(network.inputs));
        const U column = Sums::first_column(w, tiles);
        const U first = U(of.first) + Sums::first_row(w);
        float* const to = g_points.data;
        const auto each = [&](const auto& write) {
            sums.each(
                tiles, w,
                [&](auto row) {
                    const U point = first + U(std::uint32_t(row));
                    const auto there = point < U(of.end);
                    U at = point;
                    if (network.of.which != nullptr)
                        at = W::read(network.of.which, select(there, point, U(0U)));
                    return select(there, at * rows, U(nowhere));
                },
                [&](const U& at, auto n, const F& a, const F& b) {
                    const U c = column + U(std::uint32_t(8 * n));
                    write(at < U(nowhere) && c < rows, at + c, c, a, b);
                });
        };
        if (network.inputs % 2 == 0 && reinterpret_cast<std::uintptr_t>(to) % 8 == 0)
            each([&](const auto& there, const U& at, const U&, F a, F b) {
                if (again) {
                    const auto before = W::read2_where(there, to, at / U(2U));
                    a = a + before[0], b = b + before[1];
                }
                W::write2_where(there, to, at / U(2U), a, b);
            });
        else
            each([&](const auto& there, const U& at, const U& c, F a, F b) {
                const auto next = there && c + U(1U) < rows;
                if (again) {
                    a = a + W::read_where(there, to, at, 0.0F);
                    b = b + W::read_where(next, to, at + U(1U), 0.0F);
                }
                W::write_where(there, to, at, a);
                W::write_where(next, to, at + U(1U), b);
            });
    }
    /// Back through the activation whose outputs were kept.
    template <class W>
    RYE_DEVICE static void through(Shared& shared, const MlpSums<W, Tiles>& sums, int tiles,
                                   int w) {
        using F = typename W::F;
        using U = typename W::U;
        using Sums = MlpSums<W, Tiles>;
        constexpr int words = Rows::stride / 2;
        const U first = Sums::first_row(w) * U(std::uint32_t(words)) +
                        Sums::first_column(w, tiles) / U(2U);
        sums.each(
            tiles, w, [&](auto row) { return U(first + U(std::uint32_t(row * words))); },
            [&](const U& of_row, auto n, const F& a, const F& b) {
                const U word = of_row + U(std::uint32_t(4 * n));
                F low, high;
                expanded<Tiles::N>([&](auto p) {
                    const U both = W::read(
                        reinterpret_cast<const std::uint32_t*>(&shared.below.at[p][0][0]), word);
                    low = p == 0 ? W::low(both) : F(low + W::low(both));
                    high = p == 0 ? W::high(both) : F(high + W::high(both));
                });
                Sums::put(shared.cotangent, word, F(A::vjp(low, a)), F(A::vjp(high, b)));
            });
    }
};

} // namespace rye
