// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/convolution_kernels.hpp: a 3 x 3 convolution as one product without unfolding. A
/// block keeps the pixels of a tile with their border in shared memory, 32 channels at a time, and
/// all nine taps read them from there: a warp has rows of 16 pixels, and what it reads of a row of
/// the image, moved by a tap's column, is multiplied by the three taps of that column for the three
/// rows of results that it touches. The weights of a column of taps are a step; those of the next
/// steps, and the next channels, are copied meanwhile.
#pragma once

#include <rye/backend/cuda/planes.hpp>
#include <rye/math/scalar.hpp>
#include <rye/nn/cuda/tile_copies.hpp>

namespace rye::detail {

/// Sizes of a block's work: floats as N planes; `outputs` channels of the result; `high` rows of 16
/// pixels a warp, `down` warps below one another by `beside` along the outputs.
template <int N_, int outputs_, int high_, int down_, int beside_>
struct ConvolutionTiles {
    static constexpr int N = N_, outputs = outputs_, high = high_, down = down_, beside = beside_;
    static_assert(N >= 1 && N <= 3 && outputs % (8 * beside) == 0);
    static constexpr int threads = 32 * down * beside;
    static constexpr int side = 16, tall = high * down; ///< pixels of a tile
    static constexpr int chunk = 32;                    ///< channels at a time
    static constexpr int wide = outputs / (8 * beside); ///< operands of 8 outputs a warp
    static constexpr int columns = outputs / 8;         ///< and a block
    /// Words of the weights of a step: three taps, 32 channels, all outputs.
    static constexpr int step_words = 3 * 2 * columns * N * 64;
    using Image = TileShape<N, side + 2, tall + 2, chunk / 8>;
};

/// Moments of a channel over the pixels of a warp.
struct alignas(16) StripMoments {
    float count, mean; ///< an approximate mean
    float rest;        ///< sum of what the numbers are above it
    float squares;     ///< and of the squares of that
};

/// Destination of results.
struct ConvolutionResult {
    int outputs;
    float* to;                       ///< outputs x pixels
    const float* bias = nullptr;     ///< then relu(x + bias); or null: neither
    StripMoments* moments = nullptr; ///< outputs x strips(), of the results; or null
};

/// The convolution of an image's planes, as floats.
template <class Tiles>
struct ConvolutionKernel {
    static constexpr const char* name = "convolution";
    static constexpr int N = Tiles::N, threads = Tiles::threads;
    static constexpr int blocks = N == 1 && threads * Tiles::high <= 1024 ? 2 : 1;
    using Image = typename Tiles::Image;
    struct Shared {
        typename Image::Numbers image[2];
        alignas(16) std::uint32_t weight[3][std::size_t(Tiles::step_words)];
    };
    DeviceImagePlanes in;
    const std::uint32_t* weight; ///< operands by ConvolutionPackKernel (convolution_operands.hpp)
    ConvolutionResult result;

    RYE_HD int across() const { return (in.width + Tiles::side - 1) / Tiles::side; }
    RYE_HD int below() const { return (in.height + Tiles::tall - 1) / Tiles::tall; }
    RYE_HD int of_outputs() const { return (result.outputs + Tiles::outputs - 1) / Tiles::outputs; }
    Index blocks_of() const { return Index(across()) * below() * of_outputs(); }
    /// Returns the number of strips that have moments of their own.
    RYE_HD Index strips() const { return Index(across()) * below() * Tiles::down; }

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        using W = typename Block::Warp;
        const int chunks = in.padded() / Tiles::chunk;
        const Corner c = corner(block.index());
        auto sums = block.template of_warps<Sums<W>>();
        block.each_warp([&](int w) {
            copy_image<W>({c.x, c.y, 1, 0}, {{0, Image::rows}}, shared.image[0], w);
            copy_weights<W>(shared, c, 0, w);
            W::end_copies();
            copy_weights<W>(shared, c, 1, w);
            W::end_copies();
            W::wait_for_copies();
            sums[w].clear();
        });
        for (int chunk = 0; chunk < chunks; ++chunk)
            for (int column = 0; column < 3; ++column)
                block.each_warp([&](int w) {
                    copy_weights<W>(shared, c, 3 * chunk + column + 2, w);
                    if (column < 2 && chunk + 1 < chunks)
                        copy_image<W>(
                            {c.x, c.y, 1, (chunk + 1) * (Tiles::chunk / 8)},
                            {{column * half_rows, column == 0 ? int(half_rows) : int(Image::rows)}},
                            shared.image[(chunk + 1) % 2], w);
                    W::end_copies();
                    if (works(c, w))
                        sums[w].add(shared.image[chunk % 2], shared.weight[column], column, w);
                    W::wait_for_copies();
                });
        block.each_warp([&](int w) { finish(sums[w], c, w); });
    }

  private:
    static constexpr int half_rows = (Image::rows + 1) / 2;
    /// The first pixel and the first output of a block, and which tile of the pixels it has.
    struct Corner {
        int x, y, output, tile;
    };
    RYE_DEVICE Corner corner(int block) const {
        const int at = block / of_outputs();
        return {at % across() * Tiles::side, at / across() * Tiles::tall,
                block % of_outputs() * Tiles::outputs, at};
    }
    RYE_DEVICE static int first_row(int w) { return w / Tiles::beside * Tiles::high; }
    RYE_DEVICE static int first_column(int w) { return w % Tiles::beside * Tiles::wide; }
    /// Returns true if a warp has pixels and outputs.
    RYE_DEVICE bool works(const Corner& c, int w) const {
        return c.y + first_row(w) < in.height && c.output + 8 * first_column(w) < result.outputs;
    }
    /// Starts to copy rows of the pixels.
    template <class W>
    RYE_DEVICE void copy_image(const TilePlace& at, const Array<int, 2>& part,
                               typename Image::Numbers& to, int w) const {
        copy_tile<W, Image, threads>(in, at, to, part, w);
    }
    /// Starts to copy the weights of a step: column step % 3 of the taps of channels step / 3.
    template <class W>
    RYE_DEVICE void copy_weights(Shared& shared, const Corner& c, int step, int w) const {
        using U = typename W::U;
        const int steps = in.padded() / Tiles::chunk * 3;
        if (step >= steps) return;
        constexpr int quads = Tiles::step_words / 4;
        static_assert(quads % 32 == 0);
        const auto* const from = reinterpret_cast<const Quad4*>(
            weight + (Index(c.output / Tiles::outputs) * steps + step) * Tiles::step_words);
        auto* const to = reinterpret_cast<Quad4*>(&shared.weight[step % 3][0]);
        for (int first = 32 * w; first < quads; first += threads) {
            const U q = U(static_cast<std::uint32_t>(first)) + W::lane_here();
            W::copy4_or_zero(q < U(std::uint32_t(quads)), to, q, from, q);
        }
    }

    /// A warp's sums.
    template <class W>
    struct Sums {
        using F = typename W::F;
        using U = typename W::U;
        Array<F, 4> sum[std::size_t(Tiles::high)][std::size_t(Tiles::wide)];

        RYE_DEVICE void clear() {
            repeated<Tiles::high>([&](auto m) {
                repeated<Tiles::wide>(
                    [&](auto n) { repeated<4>([&](auto k) { sum[m][n][k] = F(0.0F); }); });
            });
        }
        /// += the products of a column of taps.
        RYE_DEVICE void add(const typename Image::Numbers& image, const std::uint32_t* weights,
                            int column, int w) {
            const U lane = W::lane(), x = lane % U(16U) + U(static_cast<std::uint32_t>(column));
            const U row = x * U(Image::pixel_bytes) +
                          U(static_cast<std::uint32_t>(first_row(w) * Image::row_bytes));
            repeated<2>([&](auto step) {
                const U at =
                    row + Image::swapped(lane / U(16U) + U(std::uint32_t(2 * step)), x) * U(16U);
                Planes<W, N, 2> right[3][std::size_t(Tiles::wide)];
                repeated<3>([&](auto down) {
                    repeated<Tiles::wide>([&](auto n) {
                        const int operand =
                            (step * 3 + down) * Tiles::columns + first_column(w) + n;
                        repeated<N>([&](auto p) {
                            right[down][n][p] =
                                W::read_words2(weights + (operand * N + p) * 64, lane);
                        });
                    });
                });
                expanded<Tiles::high + 2>([&](auto r) {
                    Planes<W, N, 4> left;
                    repeated<N>([&](auto p) {
                        left[p] = W::template tiles<false>(
                            &image.at[p][0], at + U(std::uint32_t(r * Image::row_bytes)));
                    });
                    expanded<3>([&](auto down) {
                        constexpr int m = decltype(r)::value - decltype(down)::value;
                        if constexpr (m >= 0 && m < Tiles::high)
                            repeated<Tiles::wide>(
                                [&](auto n) { multiply<W, N>(sum[m][n], left, right[down][n]); });
                    });
                });
            });
        }
    };

    template <class W>
    RYE_DEVICE void finish(Sums<W>& sums, const Corner& c, int w) const {
        using U = typename W::U;
        const U lane = W::lane_here();
        const U first_x = U(static_cast<std::uint32_t>(c.x)) + lane / U(4U);
        const U first_c =
            U(static_cast<std::uint32_t>(c.output + 8 * first_column(w))) + lane % U(4U) * U(2U);
        if (result.bias != nullptr) activate(sums, first_c);
        if (result.outputs % 2 == 0)
            write<W, true>(sums, c, first_x, first_c, w);
        else
            write<W, false>(sums, c, first_x, first_c, w);
        if (result.moments == nullptr) return;
        const int rows = rye::max(0, rye::min(int(Tiles::high), in.height - c.y - first_row(w))),
                  columns = rye::min(int(Tiles::side), in.width - c.x);
        const Index strip = Index(c.tile) * Tiles::down + w / Tiles::beside;
        StripMoments* const to = result.moments + strip * result.outputs;
        // Compares the count: ptxas 13.0 for sm_90 takes rows == high to hold for any rows.
        if (rows * columns == Tiles::high * Tiles::side)
            write_moments<W, true>(sums, first_c, {rows, columns}, to);
        else
            write_moments<W, false>(sums, first_c, {rows, columns}, to);
    }
    /// Part of a warp's pixels inside the image.
    struct Inside {
        int rows, columns;
    };
    template <class W>
    RYE_DEVICE void activate(Sums<W>& sums, const typename W::U& first_c) const {
        using U = typename W::U;
        const U channels(static_cast<std::uint32_t>(result.outputs));
        repeated<Tiles::wide>([&](auto n) {
            repeated<2>([&](auto k) {
                const U channel = first_c + U(std::uint32_t(8 * n + k));
                const auto own = W::read_where(channel < channels, result.bias, channel, 0.0F);
                repeated<Tiles::high>([&](auto m) {
                    repeated<2>([&](auto half) {
                        auto& x = sums.sum[m][n][2 * half + k];
                        x = relu(typename W::F(x + own));
                    });
                });
            });
        });
    }
    template <class W, bool pairs>
    RYE_DEVICE void write(const Sums<W>& sums, const Corner& c, const typename W::U& first_x,
                          const typename W::U& first_c, int w) const {
        using U = typename W::U;
        const U channels(static_cast<std::uint32_t>(result.outputs)),
            width(static_cast<std::uint32_t>(in.width));
        const U first = first_x * channels + first_c, eight = U(8U) * channels;
        repeated<Tiles::high>([&](auto m) {
            const int y = c.y + first_row(w) + m;
            if (y >= in.height) return;
            float* const row = result.to + Index(y) * in.width * result.outputs;
            repeated<2>([&](auto half) {
                const auto there = first_x + U(std::uint32_t(8 * half)) < width;
                const U at = half == 0 ? first : U(first + eight);
                repeated<Tiles::wide>([&](auto n) {
                    const U channel = first_c + U(std::uint32_t(8 * n));
                    const U own = at + U(std::uint32_t(8 * n));
                    const auto &a = sums.sum[m][n][2 * half], &b = sums.sum[m][n][2 * half + 1];
                    const auto one = there && channel < channels;
                    if constexpr (pairs) {
                        W::write2_where(one, row, own / U(2U), a, b);
                    } else {
                        W::write_where(one, row, own, a);
                        W::write_where(there && channel + U(1U) < channels, row, own + U(1U), b);
                    }
                });
            });
        });
    }
    /// Moments of each channel over a warp's pixels: about a mean in floats, so that nothing
    /// cancels. `whole`: all pixels are in the image.
    template <class W, bool whole>
    RYE_DEVICE void write_moments(const Sums<W>& sums, const typename W::U& first_c,
                                  const Inside& inside, StripMoments* to) const {
        using F = typename W::F;
        using U = typename W::U;
        const int count = inside.rows * inside.columns;
        const F share(count > 0 ? 1.0F / static_cast<float>(count) : 0.0F);
        const U channels(static_cast<std::uint32_t>(result.outputs)), lane = W::lane_here();
        // Pixels of a row that are in the image, of no row below it.
        const auto number = [](int x) { return U(static_cast<std::uint32_t>(x)); };
        const auto own = [&](auto m, auto half, const F& x) {
            if constexpr (whole)
                return x;
            else
                return F(select(
                    lane / U(4U) + number(8 * half) < number(m < inside.rows ? inside.columns : 0),
                    x, F(0.0F)));
        };
        const auto all = [](F x) {
            x = x + W::template across<4>(x);
            x = x + W::template across<8>(x);
            return F(x + W::template across<16>(x));
        };
        repeated<Tiles::wide>([&](auto n) {
            repeated<2>([&](auto k) {
                const auto each = [&](const auto& f) {
                    repeated<Tiles::high>([&](auto m) {
                        repeated<2>(
                            [&](auto half) { f(m, half, F(sums.sum[m][n][2 * half + k])); });
                    });
                };
                F sum(0.0F), rest(0.0F), squares(0.0F);
                each([&](auto m, auto half, const F& x) { sum = sum + own(m, half, x); });
                const F mean = all(sum) * share;
                each([&](auto m, auto half, const F& x) {
                    const F above = own(m, half, F(x - mean));
                    rest = rest + above;
                    squares = W::fma(above, above, squares);
                });
                const U channel = first_c + U(std::uint32_t(8 * n + k));
                W::write4_where(lane < U(4U) && channel < channels, reinterpret_cast<Quad4*>(to),
                                channel,
                                {{F(static_cast<float>(count)), mean, all(rest), all(squares)}});
            });
        });
    }
};

} // namespace rye::detail
