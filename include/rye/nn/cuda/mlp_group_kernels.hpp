// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/mlp_group_kernels.hpp: 64 points of a warpgroup through all layers of a network,
/// forward and back, with what passes from layer to layer in registers: sums of a product are laid
/// out as the left operand of the next one. All operands stay in shared memory, and groups take
/// tile after tile of points, none waiting for another; or, with `streamed`, operands pass through.
#pragma once

#include <rye/nn/cuda/mlp_group_stream.hpp>

namespace rye::detail {

/// All layers, forward; `grid` blocks share the tiles.
template <class Tiles, class A, bool streamed = false>
struct MlpGroupForwardKernel {
    static constexpr const char* name = "network, forward";
    static constexpr bool of_groups = true;
    static constexpr int threads = 128 * Tiles::groups, blocks = 1;
    static constexpr int width = Tiles::width, steps = width / 16, in_steps = Tiles::inputs / 16;
    using Shared = MlpGroupShared<Tiles, streamed>;
    MlpGroupNetwork network;
    DeviceColumns<const float> points; ///< inputs x N
    DeviceColumns<float> out;          ///< outputs x N
    bool keep;                         ///< what a vjp reads
    int grid;
    MlpGroupPieces pieces;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        block.each_thread([&](int t) {
            if (t == 0) W::set_ring(shared.operands, 4 * Tiles::groups);
            for (int i = t; i < network.layers * width; i += threads)
                shared.bias[i / width][i % width] =
                    i < (network.layers - 1) * width + network.out ? network.bias[i] : 0.0F;
        });
        const std::uint32_t count = network.of.among(network.points);
        const int first = block.index() * Tiles::groups, apart = grid * Tiles::groups;
        block.each_warp([&](int w) {
            each_round<W, Tiles, streamed>(
                shared.operands, pieces, network.forward, network.bytes,
                rounds_of(count, first, apart), w, [&](auto& source, int r) {
                    const auto tile = static_cast<std::uint32_t>(first + r * apart + w / 4);
                    if (64 * tile < count)
                        run<W>(shared, source, {tile, count, w}, w);
                    else if constexpr (streamed)
                        source.skip();
                });
        });
    }

  private:
    template <class W, class Source>
    RYE_DEVICE void run(Shared& shared, Source& source, const GroupPlace<W>& place, int w) const {
        using F = typename W::F;
        GroupRows<W, in_steps> in;
        GroupRows<W, steps> rows, next;
        place.load(in, points, network.of.which);
        if (keep)
            expanded<4 * in_steps>([&](auto i) {
                constexpr int s = decltype(i)::value / 4, r = decltype(i)::value % 4;
                place.template write<2 * in_steps>(network.input, 2 * s + r / 2, r % 2, in[s][r]);
            });
        if constexpr (streamed)
            expanded<4 * in_steps>([&](auto i) {
                W::write_word(&shared.input[i][0], own_thread<W>(w),
                              in[decltype(i)::value / 4][decltype(i)::value % 4]);
            });
        const auto layer = [&](int l, const auto& products) {
            expanded<Tiles::pieces>([&](auto p) {
                constexpr int piece = decltype(p)::value;
                Array<F, 64> sum;
                begin<W>(sum, &shared.bias[l][128 * piece], place);
                products(sum);
                activate<W>(sum, next, l, piece, place, w);
            });
            rows = next;
        };
        int l = 0;
        if constexpr (streamed)
            layer(l++,
                  [&](auto& sum) { multiply_streamed<W, 128, true, in_steps>(sum, in, source); });
        for (; l + 1 < network.layers; ++l)
            layer(l, [&](auto& sum) { product<W>(sum, l, rows, in, shared, w, source); });
        Array<F, std::size_t(Tiles::last / 2)> sum;
        begin<W>(sum, &shared.bias[network.layers - 1][0], place);
        product<W>(sum, network.layers - 1, rows, in, shared, w, source);
        finish<W>(sum, place);
    }
    /// Sums begin as biases.
    template <class W, std::size_t count>
    RYE_DEVICE static void begin(Array<typename W::F, count>& sum, const float* bias,
                                 const GroupPlace<W>& place) {
        expanded<int(count) / 4>([&](auto j) {
            const auto b = W::read2(bias + 8 * j, place.pair);
            repeated<4>([&](auto k) { sum[4 * j + k] = b[k % 2]; });
        });
    }
    template <class W>
    RYE_DEVICE static typename W::U own_thread(int w) {
        return typename W::U(static_cast<std::uint32_t>(32 * w)) + W::lane();
    }
    template <class W, std::size_t count, int slots>
    RYE_DEVICE void product(Array<typename W::F, count>& sum, int l,
                            const GroupRows<W, steps>& rows, const GroupRows<W, in_steps>&,
                            const Shared& shared, int w, MlpGroupStream<W, slots>& stream) const {
        constexpr int n = 2 * int(count);
        multiply_streamed<W, n, true, steps>(sum, rows, stream);
        if (!network.takes(l)) return;
        GroupRows<W, in_steps> in; // there are no registers to keep them
        expanded<4 * in_steps>([&](auto i) {
            in[decltype(i)::value / 4][decltype(i)::value % 4] =
                W::read(&shared.input[i][0], own_thread<W>(w));
        });
        multiply_streamed<W, n, true, in_steps>(sum, in, stream);
    }
    /// Leaves the operand behind the layer's.
    template <class W, std::size_t count>
    RYE_DEVICE void product(Array<typename W::F, count>& sum, int l,
                            const GroupRows<W, steps>& rows, const GroupRows<W, in_steps>& in,
                            const Shared&, int, const unsigned char*& operand) const {
        // Batches of products end in the branch that begins them: else units of matrices wait.
        constexpr int n = 2 * int(count);
        constexpr int of_rows = 2 * width * n, of_input = 2 * Tiles::inputs * n;
        const bool input = network.takes(l);
        const unsigned char* const at = operand;
        if (l == 0) {
            batch<W>(sum, [&] { multiply_group<W, n, true, in_steps>(sum, in, at); });
            operand += of_input;
        } else if (!input) {
            batch<W>(sum, [&] { multiply_group<W, n, true, steps>(sum, rows, at); });
            operand += of_rows;
        } else {
            batch<W>(sum, [&] {
                multiply_group<W, n, true, steps>(sum, rows, at);
                multiply_group<W, n, true, in_steps>(sum, in, at + of_rows);
            });
            operand += of_rows + of_input;
        }
    }
    /// A::value, which is the larger of x and what it is for x < 0, in fewer instructions.
    template <class W>
    RYE_DEVICE static typename W::F value(const typename W::F& x) {
        using F = typename W::F;
        static_assert(std::is_same_v<A, LeakyRelu> && leaky_slope < 1);
        return W::max(x, F(F(float(leaky_slope)) * x));
    }
    template <class W>
    RYE_DEVICE void activate(const Array<typename W::F, 64>& sum, GroupRows<W, steps>& next, int l,
                             int piece, const GroupPlace<W>& place, int w) const {
        using U = typename W::U;
        expanded<32>([&](auto i) {
            constexpr int j = decltype(i)::value / 2, h = decltype(i)::value % 2;
            next[8 * piece + j / 2][j % 2 * 2 + h] =
                W::pack(value<W>(sum[4 * j + 2 * h]), value<W>(sum[4 * j + 2 * h + 1]));
        });
        if (!keep) return;
        const Index layer = Index(l) * network.tiles();
        expanded<2>([&](auto half) {
            U bits(0U);
            expanded<16>([&](auto i) {
                constexpr int j = 8 * decltype(half)::value + decltype(i)::value / 2,
                              h = decltype(i)::value % 2;
                const U both = next[8 * piece + j / 2][j % 2 * 2 + h];
                place.template write<width / 8>(network.activated + layer * (64 * width),
                                                16 * piece + j, h, both);
                bits = bits | (W::positive(both) & U(0x00010001U << decltype(i)::value));
            });
            W::write_word(
                network.signs + ((layer + place.tile) * (width / 64) + 2 * piece + half) * 128,
                U(static_cast<std::uint32_t>(32 * (w % 4))) + W::lane(), bits);
        });
    }
    template <class W>
    RYE_DEVICE void finish(const Array<typename W::F, std::size_t(Tiles::last / 2)>& sum,
                           const GroupPlace<W>& place) const {
        using U = typename W::U;
        const U rows(static_cast<std::uint32_t>(network.out));
        const auto each = [&](const auto& write) {
            expanded<Tiles::last / 4>([&](auto i) {
                constexpr int j = decltype(i)::value / 2, h = decltype(i)::value % 2;
                const U column = place.pair * U(2U) + U(std::uint32_t(8 * j));
                write(place.there[h], column, place.point[h] * rows + column, sum[4 * j + 2 * h],
                      sum[4 * j + 2 * h + 1]);
            });
        };
        if (network.out % 2 == 0)
            each([&](const auto& there, const U& c, const U& at, const auto& a, const auto& b) {
                W::write2_where(there && c < rows, out.data, at / U(2U), a, b);
            });
        else
            each([&](const auto& there, const U& c, const U& at, const auto& a, const auto& b) {
                W::write_where(there && c < rows, out.data, at, a);
                W::write_where(there && c + U(1U) < rows, out.data, at + U(1U), b);
            });
    }
};

/// Cotangents of the outputs of all layers, for the weights' gradients, and of the inputs.
template <class Tiles, class A, bool streamed = false>
struct MlpGroupReverseKernel {
    static constexpr const char* name = "network, reverse";
    static constexpr bool of_groups = true;
    static constexpr int threads = 128 * Tiles::groups, blocks = 1;
    static constexpr int width = Tiles::width, steps = width / 16, last_steps = Tiles::last / 16;
    using Shared = MlpGroupRing<Tiles, streamed>;
    MlpGroupNetwork network;
    DeviceColumns<const float> g_out; ///< outputs x N
    DeviceColumns<float> g_points;    ///< inputs x N, at the points' columns, or null
    bool add;                         ///< to g_points
    int grid;
    MlpGroupPieces pieces;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        block.each_thread([&](int t) {
            if (t == 0) W::set_ring(shared, 4 * Tiles::groups);
        });
        const std::uint32_t count = network.of.among(network.points), tiles = (count + 63) / 64;
        const int first = block.index() * Tiles::groups, apart = grid * Tiles::groups;
        block.each_warp([&](int w) {
            each_round<W, Tiles, streamed>(
                shared, pieces, network.reverse, network.bytes, rounds_of(count, first, apart), w,
                [&](auto& source, int r) {
                    // From the last points on, whose numbers the forward pass left in the cache.
                    const auto tile = static_cast<std::uint32_t>(first + r * apart + w / 4);
                    if (tile < tiles)
                        run<W>(source, {tiles - 1 - tile, count, w}, w);
                    else if constexpr (streamed)
                        source.skip();
                });
        });
    }

  private:
    template <class W, class Source>
    RYE_DEVICE void run(Source& source, const GroupPlace<W>& place, int w) const {
        GroupRows<W, last_steps> last;
        GroupRows<W, steps> rows, next;
        place.load(last, g_out, nullptr);
        const int octets = padded_16(network.out) / 8;
        expanded<4 * last_steps>([&](auto i) {
            constexpr int s = decltype(i)::value / 4, r = decltype(i)::value % 4;
            if (octets == 4)
                place.template write<4>(network.last_cotangent, 2 * s + r / 2, r % 2, last[s][r]);
            else if (s == 0)
                place.template write<2>(network.last_cotangent, r / 2, r % 2, last[s][r]);
        });
        through<W>(last, next, network.layers - 1, source, place, w);
        rows = next;
        for (int l = network.layers - 2; l > 0; --l) {
            through<W>(rows, next, l, source, place, w);
            rows = next;
        }
        if (g_points.data != nullptr) to_points<W>(last, rows, source, place);
    }
    /// sum = or += rows times the next operand of n columns.
    template <class W, int n, bool onto, int own, int slots>
    RYE_DEVICE static void multiply(Array<typename W::F, std::size_t(n / 2)>& sum,
                                    const GroupRows<W, own>& rows,
                                    MlpGroupStream<W, slots>& stream) {
        multiply_streamed<W, n, onto, own>(sum, rows, stream);
    }
    template <class W, int n, bool onto, int own>
    RYE_DEVICE static void multiply(Array<typename W::F, std::size_t(n / 2)>& sum,
                                    const GroupRows<W, own>& rows, const unsigned char*& operand) {
        const unsigned char* const at = operand;
        batch<W>(sum, [&] { multiply_group<W, n, onto, own>(sum, rows, at); });
        operand += 16 * own * 2 * n;
    }
    /// Cotangents of layer l's outputs back to those of the layer below.
    template <class W, class Rows, class Source>
    RYE_DEVICE void through(const Rows& rows, GroupRows<W, steps>& next, int l, Source& source,
                            const GroupPlace<W>& place, int w) const {
        using F = typename W::F;
        using U = typename W::U;
        constexpr int own = int(Rows::size());
        const Index layer = Index(l - 1) * network.tiles();
        const std::uint32_t* const signs =
            network.signs + (layer + place.tile) * (width / 64) * 128;
        expanded<Tiles::pieces>([&](auto p) {
            constexpr int piece = decltype(p)::value;
            U bits[2];
            repeated<2>([&](auto half) {
                bits[half] = W::read(signs + (2 * piece + half) * 128,
                                     U(U(static_cast<std::uint32_t>(32 * (w % 4))) + W::lane()));
            });
            Array<F, 64> sum;
            multiply<W, 128, false, own>(sum, rows, source);
            expanded<32>([&](auto i) {
                constexpr int j = decltype(i)::value / 2, h = decltype(i)::value % 2,
                              bit = j % 8 * 2 + h;
                const auto slope = [&](unsigned at, const F& g) {
                    const auto up = (bits[j / 8] & U(1U << at)) > U(0U);
                    return F(A::vjp(F(select(up, F(1.0F), F(-1.0F))), g));
                };
                const U both = W::pack(slope(bit, sum[4 * j + 2 * h]),
                                       slope(bit + 16, sum[4 * j + 2 * h + 1]));
                next[8 * piece + j / 2][j % 2 * 2 + h] = both;
                place.template write<width / 8>(network.cotangent + layer * (64 * width),
                                                16 * piece + j, h, both);
            });
        });
    }
    template <class W, class Source>
    RYE_DEVICE void to_points(const GroupRows<W, last_steps>& last, GroupRows<W, steps>& rows,
                              Source& source, const GroupPlace<W>& place) const {
        using F = typename W::F;
        constexpr int n = Tiles::inputs;
        Array<F, std::size_t(n / 2)> sum;
        repeated<n / 2>([&](auto i) { sum[i] = F(0.0F); });
        const auto product = [&](const auto& own) {
            constexpr int own_steps = int(std::remove_cvref_t<decltype(own)>::size());
            multiply<W, n, true, own_steps>(sum, own, source);
        };
        product(rows);
        for (int l = 1; l + 1 < network.layers; ++l)
            if (network.takes(l)) {
                std::uint16_t* const own =
                    network.cotangent + Index(l) * network.tiles() * (64 * width);
                expanded<4 * steps>([&](auto i) {
                    constexpr int s = decltype(i)::value / 4, r = decltype(i)::value % 4;
                    rows[s][r] = place.template read<width / 8>(own, 2 * s + r / 2, r % 2);
                });
                product(rows);
            }
        if (network.takes(network.layers - 1)) product(last);
        write<W>(sum, place);
    }
    template <class W, std::size_t count>
    RYE_DEVICE void write(const Array<typename W::F, count>& sum,
                          const GroupPlace<W>& place) const {
        using F = typename W::F;
        using U = typename W::U;
        const U rows(static_cast<std::uint32_t>(network.inputs));
        float* const to = g_points.data;
        U first[2];
        repeated<2>([&](auto h) {
            U column = place.point[h];
            if (network.of.which != nullptr)
                column = W::read(network.of.which, select(place.there[h], column, U(0U)));
            first[h] = column * rows + place.pair * U(2U);
        });
        const auto each = [&](const auto& write_pair) {
            expanded<int(count) / 2>([&](auto i) {
                constexpr int j = decltype(i)::value / 2, h = decltype(i)::value % 2;
                const U column = place.pair * U(2U) + U(std::uint32_t(8 * j));
                write_pair(place.there[h] && column < rows, place.there[h] && column + U(1U) < rows,
                           to + 8 * j, first[h], sum[4 * j + 2 * h], sum[4 * j + 2 * h + 1]);
            });
        };
        if (network.inputs % 2 == 0 && reinterpret_cast<std::uintptr_t>(to) % 8 == 0)
            each([&](const auto& one, const auto&, float* at, const U& i, F a, F b) {
                if (add) {
                    const auto before = W::read2_where(one, at, i / U(2U));
                    a = a + before[0], b = b + before[1];
                }
                W::write2_where(one, at, i / U(2U), a, b);
            });
        else
            each([&](const auto& one, const auto& two, float* at, const U& i, F a, F b) {
                if (add) {
                    a = a + W::read_where(one, at, i, 0.0F);
                    b = b + W::read_where(two, at + 1, i, 0.0F);
                }
                W::write_where(one, at, i, a);
                W::write_where(two, at + 1, i, b);
            });
    }
};

} // namespace rye::detail
