// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/convolution_kernels.hpp: a 3 x 3 convolution as one product without unfolding: a
/// block has 16 x 16 pixels and keeps them with their border in shared memory, 32 channels at a
/// time, from where all nine taps read them. Eight warps: four quarters of the rows by two halves
/// of the outputs. While one tap is multiplied, the weights of the next and a ninth of the next
/// channels are on their way.
#pragma once

#include <rye/backend/cuda/planes.hpp>
#include <rye/nn/cuda/tile_quads.hpp>

namespace rye {

/// Sizes of a block's work: floats as N planes, `outputs` (32, 64 or 128) channels of the result.
template <int N_, int outputs_>
struct ConvolutionTiles {
    static constexpr int N = N_, outputs = outputs_;
    static_assert(N >= 1 && N <= 3 && outputs % 32 == 0);
    static constexpr int threads = 256;
    static constexpr int side = 16, around = side + 2, rows = around * around; ///< [px]
    static constexpr int chunk = 32;          ///< channels at a time
    static constexpr int stride = chunk + 8;  ///< of a pixel in shared memory, in other banks
    static constexpr int high = 4;            ///< rows of 16 pixels a warp
    static constexpr int wide = outputs / 16; ///< operands of 8 outputs a warp
    /// Words of the weights of a tap: 32 channels by all outputs.
    static constexpr int tap_words = 2 * (outputs / 8) * N * 64;
};

/// Weights as operands: for every tile of outputs, chunk of inputs and tap, 2 x (outputs / 8)
/// operands of 16 x 8 numbers, of each its planes, of a plane two registers a lane.
/// Element (tap, k, n) is from[first + tap tap_apart + k k_apart + n n_apart].
struct ConvolutionPackKernel {
    static constexpr const char* name = "convolution's operands";
    static constexpr int threads = 128, blocks = 8;
    struct Shared {};
    const float* from;
    Index first, tap_apart, k_apart, n_apart;
    int k_count, n_count, outputs, planes;
    std::uint32_t* to;

    RYE_HD int chunks() const { return (k_count + 31) / 32; }
    RYE_HD int tiles() const { return (n_count + outputs - 1) / outputs; }
    /// Words of one plane.
    RYE_HD Index words() const { return Index(tiles()) * chunks() * 9 * (outputs / 8) * 128; }
    Index blocks_of() const { return (words() + threads - 1) / threads; }
    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            const Index word = Index(block.index()) * threads + t;
            if (word >= words()) return;
            const Index operand = word / 64;
            const int lane = static_cast<int>(word % 64) / 2, half = static_cast<int>(word % 2);
            const int columns = outputs / 8;
            const int column = static_cast<int>(operand % columns);
            const int step = static_cast<int>(operand / columns % 2);
            const Index stage = operand / (2 * columns);
            const int tap = static_cast<int>(stage % 9);
            const int chunk = static_cast<int>(stage / 9 % chunks());
            const int tile = static_cast<int>(stage / 9 / chunks());
            const int k = chunk * 32 + step * 16 + lane % 4 * 2 + half * 8;
            const int n = tile * outputs + column * 8 + lane / 4;
            float a = at(tap, k, n), b = at(tap, k + 1, n);
            for (int p = 0; p < planes; ++p) {
                const std::uint32_t both = Block::pack(a, b);
                to[(operand * planes + p) * 64 + word % 64] = both;
                a = a - Block::low(both);
                b = b - Block::high(both);
            }
        });
    }

  private:
    RYE_DEVICE float at(int tap, int k, int n) const {
        return k < k_count && n < n_count
                   ? from[first + tap * tap_apart + k * k_apart + n * n_apart]
                   : 0.0F;
    }
};

/// The convolution of an image's planes, as floats.
template <class Tiles>
struct ConvolutionKernel {
    static constexpr const char* name = "convolution";
    static constexpr int N = Tiles::N, threads = Tiles::threads;
    static constexpr int blocks = N == 1 && Tiles::outputs <= 64 ? 2 : 1;
    struct Shared {
        alignas(16) std::uint16_t
            image[2][std::size_t(N)][std::size_t(Tiles::rows)][std::size_t(Tiles::stride)];
        alignas(16) std::uint32_t weight[2][std::size_t(Tiles::tap_words)];
    };
    DeviceImagePlanes in;
    const std::uint32_t* weight; ///< of ConvolutionPackKernel
    int outputs;                 ///< channels of the result
    const float* bias;           ///< then relu(x + bias); or null: neither
    float* out;                  ///< outputs x pixels

    RYE_HD int across() const { return (in.width + Tiles::side - 1) / Tiles::side; }
    RYE_HD int tiles() const { return (outputs + Tiles::outputs - 1) / Tiles::outputs; }
    Index blocks_of() const {
        return Index(across()) * ((in.height + Tiles::side - 1) / Tiles::side) * tiles();
    }

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        const int of_outputs = block.index() % tiles(), at = block.index() / tiles();
        const Corner corner{at % across() * Tiles::side, at / across() * Tiles::side,
                            of_outputs * Tiles::outputs};
        const int chunks = in.padded() / Tiles::chunk;
        const std::uint32_t* const own = weight + Index(of_outputs) * chunks * 9 * Tiles::tap_words;
        block.each_warp([&](int w) {
            for (int part = 0; part < 9; ++part) {
                Part<W> p;
                p.read(in, place(corner, 0), part * ninth, w);
                p.write(&shared.image[0][0][0][0]);
            }
            Weights<W> first;
            first.read(own, w);
            first.write(shared, 0);
        });
        auto sums = block.template of_warps<Sums<W>>();
        block.each_warp([&](int w) { sums[w].clear(); });
        for (int s = 0; s < 9 * chunks; ++s) {
            const int chunk = s / 9, tap = s % 9;
            block.each_warp([&](int w) {
                const bool more = s + 1 < 9 * chunks, another = chunk + 1 < chunks;
                Weights<W> next;
                Part<W> part;
                if (more) next.read(own + Index(s + 1) * Tiles::tap_words, w);
                if (another) part.read(in, place(corner, chunk + 1), tap * ninth, w);
                if (works(corner, w)) sums[w].add(shared, chunk % 2, s % 2, tap, w);
                if (more) next.write(shared, (s + 1) % 2);
                if (another) part.write(&shared.image[(chunk + 1) % 2][0][0][0]);
            });
        }
        block.each_warp([&](int w) {
            if (works(corner, w)) finish(sums[w], corner, w);
        });
    }

  private:
    /// The first pixel and the first output of a block.
    struct Corner {
        int x, y, output;
    };
    RYE_DEVICE static int first_row(int w) { return w / 2 * Tiles::high; }
    RYE_DEVICE static int first_column(int w) { return w % 2 * Tiles::wide; }
    /// Whether a warp has pixels and outputs.
    RYE_DEVICE bool works(const Corner& c, int w) const {
        return c.y + first_row(w) < in.height && c.output + 8 * first_column(w) < outputs;
    }

    /// A warp's part of a tap's weights on its way.
    template <class W>
    struct Weights {
        using U = typename W::U;
        static constexpr int quads = Tiles::tap_words / 4;
        static constexpr int own = (quads + threads - 1) / threads;
        Array<typename W::F, 4> quad[std::size_t(own)];
        U place[std::size_t(own)];

        RYE_DEVICE void read(const std::uint32_t* from, int w) {
            const auto* const all = reinterpret_cast<const Quad4*>(from);
            expanded<own>([&](auto k) {
                place[k] = U(static_cast<std::uint32_t>(k * threads + 32 * w)) + W::lane();
                quad[k] = W::read4_where(place[k] < U(quads), all, place[k]);
            });
        }
        RYE_DEVICE void write(Shared& shared, int buffer) const {
            auto* const to = reinterpret_cast<Quad4*>(&shared.weight[buffer][0]);
            expanded<own>(
                [&](auto k) { W::write4_where(place[k] < U(quads), to, place[k], quad[k]); });
        }
    };

    using Around = TileShape<N, Tiles::around, Tiles::around, Tiles::chunk / 8, Tiles::stride>;
    static constexpr int ninth = Around::quads / 9;
    static_assert(ninth * 9 == Around::quads);
    template <class W>
    using Part = TileQuads<W, Around, ninth, threads>;
    RYE_DEVICE static TilePlace place(const Corner& c, int chunk) {
        return {c.x, c.y, 1, chunk * (Tiles::chunk / 8)};
    }

    /// A warp's sums.
    template <class W>
    struct Sums {
        using F = typename W::F;
        using U = typename W::U;
        Array<F, 4> sum[std::size_t(Tiles::high)][std::size_t(Tiles::wide)];

        RYE_DEVICE void clear() {
            expanded<Tiles::high>([&](auto m) {
                expanded<Tiles::wide>(
                    [&](auto n) { expanded<4>([&](auto k) { sum[m][n][k] = F(0.0F); }); });
            });
        }
        RYE_DEVICE void add(const Shared& shared, int image, int weights, int tap, int w) {
            const U lane = W::lane();
            const U first =
                (lane % U(16U) + U(static_cast<std::uint32_t>(
                                     (first_row(w) + tap / 3) * Tiles::around + tap % 3))) *
                    U(2U * Tiles::stride) +
                lane / U(16U) * U(16U);
            expanded<2>([&](auto step) {
                Planes<W, N, 4> left[std::size_t(Tiles::high)];
                expanded<Tiles::high>([&](auto m) {
                    expanded<N>([&](auto p) {
                        left[m][p] = W::template tiles<false>(
                            &shared.image[image][p][0][0],
                            first + U(static_cast<std::uint32_t>(
                                        m * Tiles::around * 2 * Tiles::stride + 32 * step)));
                    });
                });
                expanded<Tiles::wide>([&](auto n) {
                    const std::uint32_t* const operand =
                        &shared
                             .weight[weights]
                                    [(step * (Tiles::outputs / 8) + first_column(w) + n) * N * 64];
                    Planes<W, N, 2> right;
                    expanded<N>([&](auto p) { right[p] = W::read_words2(operand + p * 64, lane); });
                    expanded<Tiles::high>(
                        [&](auto m) { multiply<W, N>(sum[m][n], left[m], right); });
                });
            });
        }
    };

    template <class W>
    RYE_DEVICE void finish(const Sums<W>& sums, const Corner& corner, int w) const {
        using F = typename W::F;
        using U = typename W::U;
        const U channels(static_cast<std::uint32_t>(outputs));
        expanded<Tiles::high>([&](auto m) {
            const int y = corner.y + first_row(w) + m;
            if (y >= in.height) return;
            float* const row = out + Index(y) * in.width * outputs;
            expanded<Tiles::wide>([&](auto n) {
                expanded<4>([&](auto k) {
                    const U x =
                        U(static_cast<std::uint32_t>(corner.x + k / 2 * 8)) + W::lane() / U(4U);
                    const U c = U(static_cast<std::uint32_t>(corner.output +
                                                             8 * (first_column(w) + n) + k % 2)) +
                                W::lane() % U(4U) * U(2U);
                    const auto there = x < U(static_cast<std::uint32_t>(in.width)) && c < channels;
                    F value = sums.sum[m][n][k];
                    if (bias != nullptr)
                        value = relu(F(value + W::read_where(there, bias, c, 0.0F)));
                    W::write_where(there, row, x * channels + c, value);
                });
            });
        });
    }
};

} // namespace rye
