// SPDX-License-Identifier: Apache-2.0
/// rye/loss/dssim.hpp: 1 - SSIM as a loss, with its gradient. The window is that of ssim.hpp;
/// images are zero-padded, as in the published code. ssim.hpp is the metric in double; this is the
/// training loss, in the scalar of the images.
/// Source: Kerbl et al., "3D Gaussian Splatting", 2023, the D-SSIM term.
#pragma once

#include <algorithm>
#include <type_traits>

#include <rye/loss/photometric.hpp>
#include <rye/loss/ssim.hpp>
#include <rye/nn/elementwise.hpp>

namespace rye {

namespace detail {

/// Returns the windowed mean of numbers: the middle one, then pairs from the ends inwards.
template <class V, class W>
[[gnu::always_inline]] RYE_HD inline V along_window(const W& weight,
                                                    const Array<V, ssim_window>& x) {
    constexpr std::size_t reach = ssim_window / 2;
    V sum = V(weight[reach]) * x[reach];
    for (std::size_t k = 0; k < reach; ++k) sum += V(weight[k]) * (x[k] + x[ssim_window - 1 - k]);
    return sum;
}

/// Separable means over the window, first down a column, then along a row, with zero padding.
/// Pixels are `channels` adjacent numbers.
template <class T>
struct Window {
    using R = real_t<T>;
    static constexpr Index reach = ssim_window / 2;

    Index channels, row, height; ///< numbers per pixel, numbers per row, rows
    Array<R, ssim_window> weight;

    explicit Window(const Image<T>& image)
        : channels(image.channels()),
          row(image.width * channels),
          height(image.height) {
        const auto w = ssim_weights();
        std::transform(w.begin(), w.end(), weight.begin(),
                       [](double x) { return static_cast<R>(x); });
    }

    /// Returns the length of a row with padding at both ends.
    Index padded() const { return row + 2 * reach * channels; }
    /// Returns the offset of the row within a padded row.
    Index inside() const { return reach * channels; }

    /// Calls f(weight, start of the row) for the rows under the window around row y.
    template <class F>
    void down(Index y, const F& f) const {
        const Index last = std::min(height - 1, y + reach);
        for (Index r = std::max<Index>(0, y - reach); r <= last; ++r)
            f(weight[static_cast<std::size_t>(r - y + reach)], r * row);
    }
    /// Returns the mean along a row; `from` points to the start of the window.
    template <class V>
    V along(const T* from) const {
        Array<V, ssim_window> x;
        for (Index k = 0; k < ssim_window; ++k)
            x[static_cast<std::size_t>(k)] = load_as<V>(from + k * channels);
        return along_window<V>(weight, x);
    }
};

/// SSIM at a pixel, and `share` times its slopes with respect to the means of x, x^2 and x y.
template <class V>
struct SsimSlopes {
    V value, by_x, by_xx, by_xy;
};

/// Returns SSIM from the windowed means u of x and v of y, the covariance of x and y, and the sum
/// of their variances.
template <class V>
[[gnu::always_inline]] RYE_HD inline SsimSlopes<V> ssim_slopes(const V& u, const V& v,
                                                               const V& covariance,
                                                               const V& variances,
                                                               const V& share) {
    const V c1 = constant<V>(ssim_c1), c2 = constant<V>(ssim_c2), two(2);
    const V a1 = two * u * v + c1, b1 = (u * u + v * v) + c1;
    const V a2 = two * covariance + c2, b2 = variances + c2;
    const V inverse = V(1) / (b1 * b2), s = a1 * a2 * inverse;
    const V d1 = a2 * inverse, d2 = a1 * inverse, e1 = s / b1, e2 = s / b2;
    return {s, V(share * two * (v * (d1 - d2) - u * (e1 - e2))), V(-share * e2),
            V(share * two * d2)};
}

/// Returns the cotangent of x, from the windowed means of the slopes by the means of x, x^2 and
/// x y.
template <class V>
[[gnu::always_inline]] RYE_HD inline V ssim_pull(const V& x, const V& y, const V& by_x,
                                                 const V& by_xx, const V& by_xy) {
    return by_x + V(2) * x * by_xx + y * by_xy;
}

/// Number of rows per chunk.
inline constexpr Index dssim_rows = 4;

} // namespace detail

/// Returns 1 - mean SSIM over all pixels and channels, and its cotangent of a. Images in 0..1.
template <class T, Backend B>
LossGradient<T> dssim(const B& backend, const Image<T>& a, const Image<T>& b) {
    using W = detail::widened_t<T>;
    detail::require_same_shape<T>("dssim", a.pixels, b.pixels, Columns<T>());
    const detail::Window<T> window(a);
    const Index size = a.pixels.size(), row = window.row, padded = window.padded();
    const T *const x = a.pixels.data(), *const y = b.pixels.data();
    // Slopes of the loss with respect to the means of x, x^2 and x y.
    const Index channels = a.pixels.rows(), pixels = a.pixels.cols();
    Columns<T> by_x(channels, pixels), by_xx(channels, pixels), by_xy(channels, pixels);
    const auto share =
        static_cast<real_t<T>>(-1.0 / static_cast<double>(std::max<Index>(size, 1)));

    const W sum = sum_chunks(
        backend.threads, window.height, detail::dssim_rows, W(0), [&](Index first, Index last) {
            VecX<T> lines = VecX<T>::Zero(4 * padded), ssim(row);
            T *const line_x = lines.data(), *const line_y = line_x + padded,
                     *const line_squares = line_y + padded, *const line_xy = line_squares + padded;
            W total(0);
            for (Index r = first; r < last; ++r) {
                each_vector<B, T>(0, row, [&]<class V>(std::type_identity<V>, Index i) {
                    V mx(0), my(0), squares(0), mxy(0);
                    window.down(r, [&](const auto& w, Index at) {
                        const V p = load_as<V>(x + at + i), q = load_as<V>(y + at + i), weight(w);
                        mx += weight * p;
                        my += weight * q;
                        squares += weight * (p * p + q * q);
                        mxy += weight * (p * q);
                    });
                    const Index to = window.inside() + i;
                    detail::store_as(mx, line_x + to);
                    detail::store_as(my, line_y + to);
                    detail::store_as(squares, line_squares + to);
                    detail::store_as(mxy, line_xy + to);
                });
                each_vector<B, T>(0, row, [&]<class V>(std::type_identity<V>, Index i) {
                    const V u = window.template along<V>(line_x + i);
                    const V v = window.template along<V>(line_y + i);
                    const V uu_vv = u * u + v * v;
                    const V covariance = window.template along<V>(line_xy + i) - u * v;
                    const V variances = window.template along<V>(line_squares + i) - uu_vv;
                    const detail::SsimSlopes<V> s =
                        detail::ssim_slopes(u, v, covariance, variances, V(share));
                    detail::store_as(s.value, ssim.data() + i);
                    detail::store_as(s.by_x, by_x.data() + r * row + i);
                    detail::store_as(s.by_xx, by_xx.data() + r * row + i);
                    detail::store_as(s.by_xy, by_xy.data() + r * row + i);
                });
                total += sum_array<W>(ssim.data(), row);
            }
            return total;
        });

    LossGradient<T> loss{T(1) + T(share) * detail::scalar_cast<T>(sum), {}};
    loss.gradient.resize(a.pixels.rows(), a.pixels.cols());
    for_chunks(
        backend.threads, window.height, detail::dssim_rows, [&](Index first, Index last, Index) {
            VecX<T> lines = VecX<T>::Zero(3 * padded);
            T *const line_x = lines.data(), *const line_xx = line_x + padded,
                     *const line_xy = line_xx + padded;
            for (Index r = first; r < last; ++r) {
                each_vector<B, T>(0, row, [&]<class V>(std::type_identity<V>, Index i) {
                    V gx(0), gxx(0), gxy(0);
                    window.down(r, [&](const auto& w, Index at) {
                        const V weight(w);
                        gx += weight * load_as<V>(by_x.data() + at + i);
                        gxx += weight * load_as<V>(by_xx.data() + at + i);
                        gxy += weight * load_as<V>(by_xy.data() + at + i);
                    });
                    const Index to = window.inside() + i;
                    detail::store_as(gx, line_x + to);
                    detail::store_as(gxx, line_xx + to);
                    detail::store_as(gxy, line_xy + to);
                });
                each_vector<B, T>(0, row, [&]<class V>(std::type_identity<V>, Index i) {
                    const Index at = r * row + i;
                    const V g = detail::ssim_pull<V>(load_as<V>(x + at), load_as<V>(y + at),
                                                     window.template along<V>(line_x + i),
                                                     window.template along<V>(line_xx + i),
                                                     window.template along<V>(line_xy + i));
                    detail::store_as(g, loss.gradient.data() + at);
                });
            }
        });
    return loss;
}

} // namespace rye
