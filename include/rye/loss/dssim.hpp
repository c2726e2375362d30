// SPDX-License-Identifier: Apache-2.0
/// rye/loss/dssim.hpp: 1 - SSIM as a loss, with its gradient. The window is that of ssim.hpp; over
/// the border images are 0, as in the published code. ssim.hpp measures; this one trains, in the
/// scalar of the images.
/// Source: Kerbl et al., "3D Gaussian Splatting", 2023, the D-SSIM term.
#pragma once

#include <string>
#include <vector>

#include <rye/loss/photometric.hpp>
#include <rye/loss/ssim.hpp>

namespace rye {

namespace detail {

/// Gaussian means of every channel, of the image's size; its own adjoint.
template <Backend B, class T>
Columns<T> window_means(const Columns<T>& image, Index width) {
    constexpr Index grain = 8, reach = ssim_window / 2;
    const Index c = image.rows(), row = width * c, height = image.cols() / width;
    const auto w = ssim_weights();
    const auto weight = [&](Index k) {
        return T(static_cast<real_t<T>>(w[static_cast<std::size_t>(k)]));
    };
    Columns<T> out(c, image.cols());
    for_chunks<typename B::threads>(height, grain, [&](Index first, Index last, Index) {
        VecX<T> padded = VecX<T>::Zero(row + 2 * reach * c);
        for (Index y = first; y < last; ++y) {
            auto sum = padded.segment(reach * c, row);
            sum.setZero();
            for (Index k = 0; k < ssim_window; ++k) {
                const Index from = y + k - reach;
                if (from < 0 || from >= height) continue;
                sum += weight(k) * Eigen::Map<const VecX<T>>(image.data() + from * row, row);
            }
            Eigen::Map<VecX<T>> to(out.data() + y * row, row);
            to = weight(0) * padded.segment(0, row);
            for (Index k = 1; k < ssim_window; ++k) to += weight(k) * padded.segment(k * c, row);
        }
    });
    return out;
}

} // namespace detail

/// 1 - mean SSIM over all pixels and channels, and its cotangent of a. Images in 0..1.
template <Backend B, class T>
LossGradient<T> dssim(const Image<T>& a, const Image<T>& b) {
    using W = widened_t<T>;
    detail::require_same_shape<T>("dssim", a.pixels, b.pixels, Columns<T>());
    const Index size = a.pixels.size();
    const auto means = [&](const Columns<T>& x) {
        return detail::window_means<B, T>(x, a.width);
    };
    const Columns<T>&x = a.pixels, &y = b.pixels;
    const Columns<T> mx = means(x), my = means(y), mxy = means(x.cwiseProduct(y));
    const Columns<T> mxx = means(x.cwiseProduct(x)), myy = means(y.cwiseProduct(y));
    Columns<T> gx(x.rows(), x.cols()), gxx = gx, gxy = gx;
    const T c1(static_cast<real_t<T>>(ssim_c1)), c2(static_cast<real_t<T>>(ssim_c2)), two(2);
    const T share(static_cast<real_t<T>>(-1.0 / static_cast<double>(std::max<Index>(size, 1))));
    const W sum = sum_chunks<typename B::threads>(
        size, 4 * detail::loss_grain, W(0), [&](Index first, Index last) {
            W total(0);
            for (Index i = first; i < last; ++i) {
                const T u = mx(i), v = my(i);
                const T a1 = two * u * v + c1, b1 = u * u + v * v + c1;
                const T a2 = two * (mxy(i) - u * v) + c2;
                const T b2 = (mxx(i) - u * u) + (myy(i) - v * v) + c2;
                const T inverse = T(1) / (b1 * b2), s = a1 * a2 * inverse;
                total += scalar_cast<W>(s);
                const T d1 = a2 * inverse, d2 = a1 * inverse, e1 = s / b1, e2 = s / b2;
                gx(i) = share * two * (v * (d1 - d2) - u * (e1 - e2));
                gxx(i) = -share * e2;
                gxy(i) = share * two * d2;
            }
            return total;
        });
    LossGradient<T> loss;
    loss.value = T(1) + share * scalar_cast<T>(sum);
    loss.gradient = means(gx) + two * x.cwiseProduct(means(gxx)) + y.cwiseProduct(means(gxy));
    return loss;
}

} // namespace rye
