// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_kernels.hpp: a block of points through all layers of a network, forward and
/// back, with what passes from layer to layer in shared memory.
#pragma once

#include <rye/nn/activations.hpp>
#include <rye/nn/cuda/mlp_sums.hpp>

namespace rye::detail {

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
            sums[w].begin(network.layer[0].to_out, w);
            rows.template load<W, warps>(PointRows{points, count, network.of.which}, first, width,
                                         inputs, w);
        });
        for (int l = 0; l < network.layers; ++l) {
            const DeviceMlpLayer& layer = network.layer[l];
            const int hidden = padded_16(layer.hidden);
            const bool last = l + 1 == network.layers;
            block.each_warp([&](int w) {
                if (keep)
                    rows.template store<W, warps>(
                        l == 0 ? network.input : network.layer[l - 1].activated, first,
                        network.points, l == 0 ? width : 0, l == 0 ? inputs : hidden, w);
                Tiles::with_part(layer.to_out.tiles, [&](auto part) {
                    sums[w].begin_with(part, layer.bias, padded_16(layer.out), w);
                    sums[w].add(part, rows, layer.to_out, w, [&](int k) {
                        return 16 * k < hidden ? 16 * k : 16 * k - hidden + width;
                    });
                    if (last) finish(part, sums[w], layer, {first, count}, w);
                });
                if (!last) sums[w].begin(network.layer[l + 1].to_out, w);
            });
            if (!last)
                block.each_warp([&](int w) {
                    Tiles::with_part(layer.to_out.tiles,
                                     [&](auto part) { activate<W>(part, rows, sums[w], w); });
                });
        }
    }

  private:
    struct Range {
        std::uint32_t first, end; ///< points
    };
    /// Columns beyond the layer's are those of a sum of 0.
    template <class W, class Part>
    RYE_DEVICE static void activate(Part part, Rows& rows, const MlpSums<W, Tiles>& sums, int w) {
        using F = typename W::F;
        using U = typename W::U;
        sums.each_word(part, rows, w, [&](const U& word, const F& a, const F& b) {
            MlpSums<W, Tiles>::put(rows, word, F(A::value(a)), F(A::value(b)));
        });
    }
    template <class W, class Part>
    RYE_DEVICE void finish(Part part, const MlpSums<W, Tiles>& sums, const DeviceMlpLayer& layer,
                           const Range& of, int w) const {
        using F = typename W::F;
        using U = typename W::U;
        using Sums = MlpSums<W, Tiles>;
        const U rows(static_cast<std::uint32_t>(layer.out));
        const U column = Sums::first_column(part, w);
        const U first = U(of.first) + Sums::first_row(part, w);
        const auto each = [&](const auto& write) {
            sums.each(
                part, [&](auto row) { return U(first + U(std::uint32_t(row))); },
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
        Rows cotangent, below; ///< cotangents of a layer's outputs; outputs of the layer below
    };
    DeviceMlpNetwork network;
    DeviceColumns<const float> g_out; ///< outputs x N
    DeviceColumns<float> g_points;    ///< inputs x N, at the points' columns, or null
    bool add;                         ///< to g_points

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
            begin_layer(sums[w], network.layers - 1, w);
            shared.cotangent.template load<W, warps>(PointRows{g_out, count}, first, 0,
                                                     padded_16(static_cast<int>(g_out.rows)), w);
        });
        bool again = add; // a layer above has written g_points
        for (int l = network.layers - 1; l >= 0; --l) {
            const DeviceMlpLayer& layer = network.layer[l];
            const int hidden = padded_16(layer.hidden);
            const bool input = to_input(l);
            const auto column = [](int k) { return 16 * k; };
            block.each_warp([&](int w) {
                if (hidden > 0)
                    shared.below.template fetch<W, warps>(network.layer[l - 1].activated, first,
                                                          network.points, hidden, w);
                W::end_copies();
                shared.cotangent.template store<W, warps>(layer.cotangent, first, network.points, 0,
                                                          padded_16(layer.out), w);
                if (input) {
                    sums[w].clear();
                    Tiles::with_part(layer.out_to_input.tiles, [&](auto part) {
                        sums[w].add(part, shared.cotangent, layer.out_to_input, w, column);
                        if (hidden > 0) sums[w].begin(layer.out_to_hidden, w);
                        to_points(part, sums[w], {first, count}, w, again);
                    });
                }
                if (hidden > 0) {
                    sums[w].clear();
                    Tiles::with_part(layer.out_to_hidden.tiles, [&](auto part) {
                        sums[w].add(part, shared.cotangent, layer.out_to_hidden, w, column);
                    });
                    begin_layer(sums[w], l - 1, w);
                }
                W::template wait_for_copies<0>();
            });
            again = again || input;
            if (hidden > 0)
                block.each_warp([&](int w) {
                    Tiles::with_part(layer.out_to_hidden.tiles,
                                     [&](auto part) { through<W>(part, shared, sums[w], w); });
                });
        }
    }

  private:
    static constexpr std::uint32_t nowhere = 0xFFFFFFFFU; ///< numbers of all points are fewer
    struct Range {
        std::uint32_t first, end; ///< points
    };
    RYE_DEVICE bool to_input(int l) const {
        return network.layer[l].takes_input && g_points.data != nullptr;
    }
    /// Starts to read the first operand of a layer, if it has one.
    template <class Sums>
    RYE_DEVICE void begin_layer(Sums& sums, int l, int w) const {
        const DeviceMlpLayer& layer = network.layer[l];
        if (to_input(l))
            sums.begin(layer.out_to_input, w);
        else if (layer.hidden > 0)
            sums.begin(layer.out_to_hidden, w);
    }
    template <class W, class Part>
    RYE_DEVICE void to_points(Part part, const MlpSums<W, Tiles>& sums, const Range& of, int w,
                              bool again) const {
        using F = typename W::F;
        using U = typename W::U;
        using Sums = MlpSums<W, Tiles>;
        const U rows(static_cast<std::uint32_t>(network.inputs));
        const U column = Sums::first_column(part, w);
        const U first = U(of.first) + Sums::first_row(part, w);
        float* const to = g_points.data;
        const auto each = [&](const auto& write) {
            sums.each(
                part,
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
    template <class W, class Part>
    RYE_DEVICE static void through(Part part, Shared& shared, const MlpSums<W, Tiles>& sums,
                                   int w) {
        using F = typename W::F;
        using U = typename W::U;
        sums.each_word(part, shared.cotangent, w, [&](const U& word, const F& a, const F& b) {
            F low, high;
            repeated<Tiles::N>([&](auto p) {
                const U both = W::read(
                    reinterpret_cast<const std::uint32_t*>(&shared.below.at[p][0][0]), word);
                low = p == 0 ? W::low(both) : F(low + W::low(both));
                high = p == 0 ? W::high(both) : F(high + W::high(both));
            });
            MlpSums<W, Tiles>::put(shared.cotangent, word, F(A::vjp(low, a)), F(A::vjp(high, b)));
        });
    }
};

} // namespace rye::detail
