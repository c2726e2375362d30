// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_kernels.hpp: a block of points through all layers of a network, forward and
/// back, with what passes from layer to layer in shared memory.
#pragma once

#include <rye/nn/activations.hpp>
#include <rye/nn/cuda/mlp_sums.hpp>

namespace rye {

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
        const U word =
            Sums::first_row(w) * U(std::uint32_t(words)) + Sums::first_column(w, tiles) / U(2U);
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
        const U first =
            Sums::first_row(w) * U(std::uint32_t(words)) + Sums::first_column(w, tiles) / U(2U);
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
