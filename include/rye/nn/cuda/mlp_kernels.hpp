// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_kernels.hpp: a block of points through all layers of a network, forward and
/// back, with what passes from layer to layer in shared memory. Eight warps: two halves of the
/// points by four quarters of a layer's outputs. Weights stream from the cache, as operands.
#pragma once

#include <rye/nn/activations.hpp>
#include <rye/nn/cuda/mlp_operands.hpp>

namespace rye {

/// Sizes of a block's work: widths at most `width`, inputs of points at most `inputs`, both
/// multiples of 32; floats as N planes.
template <int N_, int width_, int inputs_>
struct MlpTiles {
    static constexpr int N = N_, width = width_, inputs = inputs_;
    static_assert(N >= 1 && N <= 3 && width % 32 == 0 && inputs % 32 == 0);
    static constexpr int warps = 8, threads = 32 * warps;
    static constexpr int points = N == 1 ? 128 : N == 2 ? 64 : 32; ///< of a block
    static constexpr int high = points / 32;                       ///< operands of 16 points a warp
    static constexpr int wide = (width > inputs ? width : inputs) / 32; ///< and of 8 columns

    using Hidden = PlaneRows<N, points, width>;
    using Input = PlaneRows<N, points, inputs>;

    RYE_DEVICE static int first_row(int w) { return w / 4 * (points / 2); }
    /// Columns of operands, of `count`, that warp w has: [first, first + own).
    RYE_DEVICE static int own(int count) { return (count + 3) / 4; }
    RYE_DEVICE static int first(int w, int count) { return w % 4 * own(count); }
};

/// A warp's sums, and what is done with them.
template <class W, class Tiles>
struct MlpSums {
    using F = typename W::F;
    using U = typename W::U;
    using Right = Planes<W, Tiles::N, 2>;
    using Two = Array<F, 2>;
    Array<F, 4> sum[std::size_t(Tiles::high)][std::size_t(Tiles::wide)];

    RYE_DEVICE void clear() {
        expanded<Tiles::high>([&](auto m) {
            expanded<Tiles::wide>(
                [&](auto n) { expanded<4>([&](auto k) { sum[m][n][k] = F(0.0F); }); });
        });
    }

    /// += rows times the operand; `depth` and `count`: its numbers along K and N. Tiles of the
    /// operand are on their way while those before are multiplied.
    template <class Rows>
    RYE_DEVICE void add(const Rows& rows, const std::uint32_t* operand, int depth, int count,
                        int w) {
        const int tiles = padded_16(count) / 8, own = Tiles::own(tiles),
                  first = Tiles::first(w, tiles), steps = padded_16(depth) / 16;
        const int there = rye::min(own, tiles - first);
        Right next[std::size_t(Tiles::wide)];
        const auto fetch = [&](int k) {
            expanded<Tiles::wide>([&](auto n) {
                if (n < there) next[n] = packed_tile<W, Tiles::N>(operand, k * tiles + first + n);
            });
        };
        if (steps > 0) fetch(0);
        for (int k = 0; k < steps; ++k) {
            Right right[std::size_t(Tiles::wide)];
            expanded<Tiles::wide>([&](auto n) { right[n] = next[n]; });
            if (k + 1 < steps) fetch(k + 1);
            Planes<W, Tiles::N, 4> left[std::size_t(Tiles::high)];
            expanded<Tiles::high>(
                [&](auto m) { left[m] = rows.template left<W>(Tiles::first_row(w) / 16 + m, k); });
            expanded<Tiles::wide>([&](auto n) {
                if (n < there)
                    expanded<Tiles::high>(
                        [&](auto m) { multiply<W, Tiles::N>(sum[m][n], left[m], right[n]); });
            });
        }
    }

    /// read(row, column) of the pairs of 16 rows and a few columns, then f(row, column, a, b, what
    /// was read) of each: reads are on their way at once, though f writes memory.
    template <class V, class Read, class F2>
    RYE_DEVICE void each_pair_with(int count, int w, const Read& read, const F2& f) const {
        constexpr int at_once = rye::min(Tiles::wide, Tiles::N == 1 ? 2 : 4);
        const int tiles = padded_16(count) / 8, own = Tiles::own(tiles),
                  first = Tiles::first(w, tiles);
        const int there = rye::min(own, tiles - first);
        expanded<Tiles::high>([&](auto m) {
            const auto row = [&](int half) {
                return U(static_cast<std::uint32_t>(Tiles::first_row(w) + 16 * m + 8 * half)) +
                       W::lane() / U(4);
            };
            const auto column = [&](int n) {
                return U(static_cast<std::uint32_t>(8 * (first + n))) + W::lane() % U(4) * U(2);
            };
            expanded<(Tiles::wide + at_once - 1) / at_once>([&](auto group) {
                V kept[std::size_t(at_once)][2];
                const auto each = [&](const auto& g) {
                    expanded<at_once>([&](auto k) {
                        constexpr int n = decltype(group)::value * at_once + decltype(k)::value;
                        if constexpr (n < Tiles::wide)
                            if (n < there)
                                expanded<2>(
                                    [&](auto half) { g(Constant<n>{}, half, kept[k][half]); });
                    });
                };
                each([&](auto n, auto half, V& own_value) {
                    own_value = read(row(half), column(n));
                });
                each([&](auto n, auto half, V& own_value) {
                    f(row(half), column(n), sum[m][n][2 * half], sum[m][n][2 * half + 1],
                      own_value);
                });
            });
        });
    }
    /// read(column) of all pairs of columns once, then f(row, column, a, b, what was read).
    template <class V, class Read, class F2>
    RYE_DEVICE void each_pair_of_columns(int count, int w, const Read& read, const F2& f) const {
        const int tiles = padded_16(count) / 8, own = Tiles::own(tiles),
                  first = Tiles::first(w, tiles);
        V kept[std::size_t(Tiles::wide)];
        expanded<Tiles::wide>([&](auto n) {
            if (n < own && first + n < tiles)
                kept[n] =
                    read(U(static_cast<std::uint32_t>(8 * (first + n))) + W::lane() % U(4) * U(2));
        });
        expanded<Tiles::high>([&](auto m) {
            expanded<Tiles::wide>([&](auto n) {
                if (n < own && first + n < tiles)
                    expanded<2>([&](auto half) {
                        const U row =
                            U(static_cast<std::uint32_t>(Tiles::first_row(w) + 16 * m + 8 * half)) +
                            W::lane() / U(4);
                        const U column = U(static_cast<std::uint32_t>(8 * (first + n))) +
                                         W::lane() % U(4) * U(2);
                        f(row, column, sum[m][n][2 * half], sum[m][n][2 * half + 1], kept[n]);
                    });
            });
        });
    }

    /// Two numbers as planes.
    template <class Rows>
    RYE_DEVICE static void put(Rows& rows, const U& row, const U& column, F a, F b) {
        expanded<Tiles::N>([&](auto p) {
            const U both = W::pack(a, b);
            W::write_word(&rows.at[p][0][0], (row * U(Rows::stride) + column) / U(2), both);
            a = a - W::low(both);
            b = b - W::high(both);
        });
    }
};

/// All layers of a network, forward, for a block of points.
template <class Tiles, class A>
struct MlpForwardKernel {
    static constexpr const char* name = "network, forward";
    static constexpr int threads = Tiles::threads, blocks = 1;
    struct Shared {
        typename Tiles::Hidden hidden;
        typename Tiles::Input input;
    };
    DeviceMlpNetwork network;
    DeviceColumns<const float> points; ///< inputs x N
    DeviceColumns<float> out;          ///< outputs x N
    bool keep;                         ///< what a vjp reads

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        const auto first = static_cast<std::uint32_t>(block.index()) * Tiles::points;
        const std::uint32_t count = network.of.among(network.points);
        if (first >= count) return;
        const int inputs = padded_16(network.inputs);
        const PointRows rows{points, count, network.of.which};
        block.each_warp(
            [&](int w) { shared.input.template load<W>(rows, first, inputs, w, Tiles::warps); });
        if (keep)
            block.each_thread([&](int t) {
                shared.input.store(network.input, first, network.points, inputs, t, threads);
            });
        auto sums = block.template of_warps<MlpSums<W, Tiles>>();
        for (int l = 0; l < network.layers; ++l) {
            const DeviceMlpLayer& layer = network.layer[l];
            block.each_warp([&](int w) {
                sums[w].clear();
                if (layer.hidden > 0)
                    sums[w].add(shared.hidden, layer.hidden_to_out, layer.hidden, layer.out, w);
                if (layer.takes_input)
                    sums[w].add(shared.input, layer.input_to_out, network.inputs, layer.out, w);
            });
            const bool last = l + 1 == network.layers;
            block.each_warp([&](int w) {
                if (last)
                    finish(sums[w], layer, {first, count}, w);
                else
                    activate<W>(shared, sums[w], layer, w);
            });
            if (keep && !last)
                block.each_thread([&](int t) {
                    shared.hidden.store(layer.activated, first, network.points,
                                        padded_16(layer.out), t, threads);
                });
        }
    }

  private:
    struct Rows {
        std::uint32_t first, end; ///< points
    };
    template <class W>
    RYE_DEVICE static void activate(Shared& shared, const MlpSums<W, Tiles>& sums,
                                    const DeviceMlpLayer& layer, int w) {
        using F = typename W::F;
        using U = typename W::U;
        const U out(static_cast<std::uint32_t>(layer.out));
        using Sums = MlpSums<W, Tiles>;
        sums.template each_pair_of_columns<typename Sums::Two>(
            layer.out, w, [&](const U& c) { return biases<W>(layer, c); },
            [&](const U& row, const U& column, const F& a, const F& b,
                const typename Sums::Two& bias) {
                const auto value = [&](const F& x, const F& of, const U& c) {
                    return select(c < out, F(A::value(F(x + of))), F(0.0F));
                };
                Sums::put(shared.hidden, row, column, value(a, bias[0], column),
                          value(b, bias[1], column + U(1)));
            });
    }
    /// Biases of an even column and the next.
    template <class W>
    RYE_DEVICE static Array<typename W::F, 2> biases(const DeviceMlpLayer& layer,
                                                     const typename W::U& c) {
        using U = typename W::U;
        const U out(static_cast<std::uint32_t>(layer.out));
        return {{W::read_where(c < out, layer.bias, c, 0.0F),
                 W::read_where(c + U(1) < out, layer.bias, c + U(1), 0.0F)}};
    }
    template <class W>
    RYE_DEVICE void finish(const MlpSums<W, Tiles>& sums, const DeviceMlpLayer& layer,
                           const Rows& of, int w) const {
        using F = typename W::F;
        using U = typename W::U;
        using Two = typename MlpSums<W, Tiles>::Two;
        const U rows(static_cast<std::uint32_t>(layer.out));
        sums.template each_pair_of_columns<Two>(
            layer.out, w, [&](const U& c) { return biases<W>(layer, c); },
            [&](const U& row, const U& column, const F& a, const F& b, const Two& bias) {
                const U point = U(of.first) + row;
                const auto one = [&](const F& x, const F& own, const U& c) {
                    W::write_where(c < rows && point < U(of.end), out.data, point * rows + c,
                                   F(x + own));
                };
                one(a, bias[0], column);
                one(b, bias[1], column + U(1));
            });
    }
};

/// Cotangents of the outputs of all layers, for the weights' gradients, and of the inputs.
template <class Tiles, class A>
struct MlpReverseKernel {
    static constexpr const char* name = "network, reverse";
    static constexpr int threads = Tiles::threads, blocks = 1;
    struct Shared {
        typename Tiles::Hidden cotangent;
    };
    DeviceMlpNetwork network;
    DeviceColumns<const float> g_out; ///< outputs x N
    DeviceColumns<float> g_points;    ///< inputs x N, at the points' columns, or null
    bool add;                         ///< to g_points

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        const auto first = static_cast<std::uint32_t>(block.index()) * Tiles::points;
        const std::uint32_t count = network.of.among(network.points);
        if (first >= count) return;
        block.each_warp([&](int w) {
            shared.cotangent.template load<W>(PointRows{g_out, count}, first,
                                              padded_16(static_cast<int>(g_out.rows)), w,
                                              Tiles::warps);
        });
        auto sums = block.template of_warps<MlpSums<W, Tiles>>();
        bool again = add; // a layer above has written g_points
        for (int l = network.layers - 1; l >= 0; --l) {
            const DeviceMlpLayer& layer = network.layer[l];
            block.each_thread([&](int t) {
                shared.cotangent.store(layer.cotangent, first, network.points, padded_16(layer.out),
                                       t, threads);
            });
            if (layer.takes_input && g_points.data != nullptr) {
                block.each_warp([&](int w) {
                    sums[w].clear();
                    sums[w].add(shared.cotangent, layer.out_to_input, layer.out, network.inputs, w);
                    to_points(sums[w], {first, count}, w, again);
                });
                again = true;
            }
            if (layer.hidden == 0) continue;
            block.each_warp([&](int w) {
                sums[w].clear();
                sums[w].add(shared.cotangent, layer.out_to_hidden, layer.out, layer.hidden, w);
            });
            const std::uint16_t* const below = network.layer[l - 1].activated;
            block.each_warp([&](int w) {
                through(shared, sums[w], {layer.hidden, below}, {first, count}, w);
            });
        }
    }

  private:
    struct Rows {
        std::uint32_t first, end; ///< points
    };
    struct Below {
        int hidden;
        const std::uint16_t* activated;
    };
    template <class W>
    RYE_DEVICE void to_points(const MlpSums<W, Tiles>& sums, const Rows& of, int w,
                              bool again) const {
        using F = typename W::F;
        using U = typename W::U;
        const U rows(static_cast<std::uint32_t>(network.inputs));
        struct Before {
            U at;
            typename MlpSums<W, Tiles>::Two value;
        };
        const auto inside = [&](const U& row, const U& c) {
            return U(of.first) + row < U(of.end) && c < rows;
        };
        sums.template each_pair_with<Before>(
            network.inputs, w,
            [&](const U& row, const U& column) {
                const U point = U(of.first) + row;
                U to = point;
                if (network.of.which != nullptr)
                    to = W::read(network.of.which, select(point < U(of.end), point, U(0)));
                Before r{to * rows + column, {{F(0.0F), F(0.0F)}}};
                if (again) {
                    const auto read = [&](const U& c, const U& at) {
                        return W::read_where(inside(row, c), g_points.data, at, 0.0F);
                    };
                    r.value = {{read(column, r.at), read(column + U(1), r.at + U(1))}};
                }
                return r;
            },
            [&](const U& row, const U& column, const F& a, const F& b, const Before& before) {
                W::write_where(inside(row, column), g_points.data, before.at,
                               F(a + before.value[0]));
                W::write_where(inside(row, column + U(1)), g_points.data, before.at + U(1),
                               F(b + before.value[1]));
            });
    }
    /// Back through the activation whose outputs were kept.
    template <class W>
    RYE_DEVICE void through(Shared& shared, const MlpSums<W, Tiles>& sums, const Below& layer,
                            const Rows& of, int w) const {
        using F = typename W::F;
        using U = typename W::U;
        const int hidden = layer.hidden;
        const U width(static_cast<std::uint32_t>(padded_16(hidden)));
        const U most(static_cast<std::uint32_t>(hidden));
        using Kept = Array<U, std::size_t(Tiles::N)>;
        sums.template each_pair_with<Kept>(
            hidden, w,
            [&](const U& row, const U& column) {
                const U point = U(of.first) + row;
                const U at = select(point < U(of.end), (point * width + column) / U(2), U(0));
                Kept r;
                expanded<Tiles::N>([&](auto p) {
                    r[p] = W::read(
                        reinterpret_cast<const std::uint32_t*>(
                            layer.activated + Index(p) * network.points * padded_16(hidden)),
                        at);
                });
                return r;
            },
            [&](const U& row, const U& column, const F& a, const F& b, const Kept& kept) {
                const auto there = U(of.first) + row < U(of.end);
                F low(0.0F), high(0.0F);
                expanded<Tiles::N>([&](auto p) {
                    low = low + W::low(kept[p]);
                    high = high + W::high(kept[p]);
                });
                const auto one = [&](const F& y, const F& g, const U& c) {
                    return select(there && c < most, F(A::vjp(y, g)), F(0.0F));
                };
                MlpSums<W, Tiles>::put(shared.cotangent, row, column, one(low, a, column),
                                       one(high, b, column + U(1)));
            });
    }
};

} // namespace rye
