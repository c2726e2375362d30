// SPDX-License-Identifier: Apache-2.0
/// rye/loss/cuda/dssim.hpp: 1 - SSIM of pictures in device memory, value and cotangent, with the
/// formula, window and zero padding of loss/dssim.hpp. Two kernels work on tiles of pixels: the
/// first writes the slopes of SSIM with respect to windowed means as maps, the second takes
/// windowed means of the slopes, which give the cotangent. Means are separable, in shared memory.
///     DeviceDssim<CudaDevice> dssim(device);
///     terms.push_back(dssim.into(queue, picture, truth, weight, g));
#pragma once

#include <algorithm>

#include <rye/loss/cuda/terms.hpp>
#include <rye/loss/dssim.hpp>

namespace rye {

namespace detail {

/// Tiles of a picture, each with a margin of the window's reach.
struct DssimTiles {
    static constexpr int width = 32, height = 16, threads = 256;
    static constexpr int reach = ssim_window / 2;
    static constexpr int wide = width + 2 * reach, high = height + 2 * reach;

    int picture_width, picture_height, channels;
    Array<float, ssim_window> weight;

    DssimTiles(int w, int h, int c) : picture_width(w), picture_height(h), channels(c), weight{} {
        const auto exact = detail::ssim_weights();
        std::transform(exact.begin(), exact.end(), weight.begin(),
                       [](double x) { return static_cast<float>(x); });
    }
    RYE_HD int across() const { return (picture_width + width - 1) / width; }
    Index blocks_of() const { return Index(across()) * ((picture_height + height - 1) / height); }
    RYE_HD int left(int block) const { return block % across() * width; }
    RYE_HD int top(int block) const { return block / across() * height; }
    RYE_HD bool inside(int x, int y) const {
        return x >= 0 && x < picture_width && y >= 0 && y < picture_height;
    }
    /// Returns the offset of channel c of pixel (x, y).
    RYE_HD Index at(int x, int y, int c) const {
        return (Index(y) * picture_width + x) * channels + c;
    }

    /// Calls f(row, column, x, y) for thread t's share of the tile and its margin.
    template <class F>
    RYE_DEVICE void each_around(int block, int t, const F& f) const {
        for (int i = t; i < wide * high; i += threads)
            f(i / wide, i % wide, left(block) + i % wide - reach, top(block) + i / wide - reach);
    }
    /// Calls f(row, column) for thread t's share of the tile's rows, each with its margin.
    template <class F>
    RYE_DEVICE static void each_line(int t, const F& f) {
        for (int i = t; i < wide * height; i += threads) f(i / wide, i % wide);
    }
    /// Calls f(row, column, x, y) for thread t's share of the tile's pixels.
    template <class F>
    RYE_DEVICE void each_pixel(int block, int t, const F& f) const {
        for (int i = t; i < width * height; i += threads) {
            const int x = left(block) + i % width, y = top(block) + i / width;
            if (inside(x, y)) f(i / width, i % width, x, y);
        }
    }
    /// Returns the windowed mean along a line.
    RYE_DEVICE float along(const float* line) const {
        Array<float, ssim_window> x{};
        for (std::size_t k = 0; k < ssim_window; ++k) x[k] = line[k];
        return detail::along_window<float>(weight, x);
    }
};

/// Kernel of the SSIM of a tile and its slopes with respect to the means of x, x^2 and x y.
template <class P>
struct DssimSlopesKernel {
    static constexpr const char* name = "slopes of SSIM";
    static constexpr int threads = DssimTiles::threads, blocks = 4;
    struct Shared {
        float x[DssimTiles::high][DssimTiles::wide], y[DssimTiles::high][DssimTiles::wide];
        float line[4][DssimTiles::height][DssimTiles::wide]; ///< x, y, x^2 + y^2, x y
        double sum[threads];
    };
    DssimTiles tiles;
    const float* a;
    const P* b;
    float share; ///< weight of one value in the loss
    float *by_x, *by_xx, *by_xy;
    double* partial;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        block.each_thread([&](int t) { shared.sum[t] = 0; });
        for (int c = 0; c < tiles.channels; ++c) {
            block.each_thread([&](int t) {
                tiles.each_around(block.index(), t, [&](int row, int column, int x, int y) {
                    const bool there = tiles.inside(x, y);
                    const Index at = there ? tiles.at(x, y, c) : Index(0);
                    shared.x[row][column] = there ? a[at] : 0.0F;
                    shared.y[row][column] = there ? unit_value(b[at]) : 0.0F;
                });
            });
            block.each_thread([&](int t) {
                DssimTiles::each_line(t, [&](int row, int column) {
                    float mx = 0, my = 0, squares = 0, mxy = 0;
                    for (int k = 0; k < ssim_window; ++k) {
                        const float p = shared.x[row + k][column], q = shared.y[row + k][column];
                        const float weight = tiles.weight[static_cast<std::size_t>(k)];
                        mx += weight * p;
                        my += weight * q;
                        squares += weight * (p * p + q * q);
                        mxy += weight * (p * q);
                    }
                    shared.line[0][row][column] = mx;
                    shared.line[1][row][column] = my;
                    shared.line[2][row][column] = squares;
                    shared.line[3][row][column] = mxy;
                });
            });
            block.each_thread([&](int t) {
                double sum = 0;
                tiles.each_pixel(block.index(), t, [&](int row, int column, int x, int y) {
                    const auto mean = [&](int k) {
                        return tiles.along(&shared.line[k][row][column]);
                    };
                    const float u = mean(0), v = mean(1), uu_vv = u * u + v * v;
                    const auto s =
                        detail::ssim_slopes<float>(u, v, mean(3) - u * v, mean(2) - uu_vv, share);
                    const Index at = tiles.at(x, y, c);
                    by_x[at] = s.by_x;
                    by_xx[at] = s.by_xx;
                    by_xy[at] = s.by_xy;
                    sum += static_cast<double>(s.value);
                });
                shared.sum[t] += sum;
            });
        }
        add_up(block, shared.sum);
        block.each_thread([&](int t) {
            if (t == 0) partial[block.index()] = shared.sum[0];
        });
    }
};

/// Kernel of the cotangent of a tile, from the maps of slopes.
template <class P>
struct DssimPullKernel {
    static constexpr const char* name = "gradient of SSIM";
    static constexpr int threads = DssimTiles::threads, blocks = 4;
    struct Shared {
        float slope[3][DssimTiles::high][DssimTiles::wide];
        float line[3][DssimTiles::height][DssimTiles::wide];
    };
    DssimTiles tiles;
    const float* a;
    const P* b;
    float weight;
    const float *by_x, *by_xx, *by_xy;
    float* g; ///< accumulated

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        for (int c = 0; c < tiles.channels; ++c) {
            block.each_thread([&](int t) {
                tiles.each_around(block.index(), t, [&](int row, int column, int x, int y) {
                    const bool there = tiles.inside(x, y);
                    const Index at = there ? tiles.at(x, y, c) : Index(0);
                    shared.slope[0][row][column] = there ? by_x[at] : 0.0F;
                    shared.slope[1][row][column] = there ? by_xx[at] : 0.0F;
                    shared.slope[2][row][column] = there ? by_xy[at] : 0.0F;
                });
            });
            block.each_thread([&](int t) {
                DssimTiles::each_line(t, [&](int row, int column) {
                    for (int k = 0; k < 3; ++k) {
                        float sum = 0;
                        for (int i = 0; i < ssim_window; ++i)
                            sum += tiles.weight[static_cast<std::size_t>(i)] *
                                   shared.slope[k][row + i][column];
                        shared.line[k][row][column] = sum;
                    }
                });
            });
            block.each_thread([&](int t) {
                tiles.each_pixel(block.index(), t, [&](int row, int column, int x, int y) {
                    const Index at = tiles.at(x, y, c);
                    g[at] += weight *
                             detail::ssim_pull<float>(a[at], unit_value(b[at]),
                                                      tiles.along(&shared.line[0][row][column]),
                                                      tiles.along(&shared.line[1][row][column]),
                                                      tiles.along(&shared.line[2][row][column]));
                });
            });
        }
    }
};

} // namespace detail

/// D-SSIM loss of pictures in device memory, with the maps between its kernels.
template <class Device>
class DeviceDssim {
  public:
    explicit DeviceDssim(const Device& device) : device_(device) {}

    /// Returns 1 - mean SSIM of a (float) and b (float or bytes) as a term of weight `weight`; adds
    /// `weight` times its cotangent of a to g. Throws an Error unless a, b and g have one shape.
    template <class P>
    DeviceLossTerm into(const CudaQueue& queue, const DevicePicture<const float>& a,
                        const DevicePicture<const P>& b, double weight,
                        const DevicePicture<float>& g) {
        detail::require_picture("dssim", "second picture", b, a.pixels.rows, a.width, a.height);
        detail::require_picture("dssim", "gradient", g, a.pixels.rows, a.width, a.height);
        const Index size = a.pixels.size();
        const detail::DssimTiles tiles(a.width, a.height, static_cast<int>(a.pixels.rows));
        maps_.reserve(queue, 3 * static_cast<std::size_t>(size) + 1);
        float *const by_x = maps_.data(), *const by_xx = by_x + size, *const by_xy = by_xx + size;
        const double share = -1.0 / static_cast<double>(std::max<Index>(size, 1));
        double* const partial = sums_.reserve(queue, tiles.blocks_of());
        device_.launch(
            queue, tiles.blocks_of(),
            detail::DssimSlopesKernel<P>{tiles, a.pixels.data, b.pixels.data,
                                         static_cast<float>(share), by_x, by_xx, by_xy, partial});
        device_.launch(queue, tiles.blocks_of(),
                       detail::DssimPullKernel<P>{tiles, a.pixels.data, b.pixels.data,
                                                  static_cast<float>(weight), by_x, by_xx, by_xy,
                                                  g.pixels.data});
        return {partial, tiles.blocks_of(), share, 1.0, weight};
    }
    /// Returns the memory held [bytes].
    std::size_t bytes() const { return maps_.bytes() + sums_.bytes(); }

  private:
    Device device_;
    DeviceBuffer<float> maps_;
    detail::LossSums sums_;
};

} // namespace rye
