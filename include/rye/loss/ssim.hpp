// SPDX-License-Identifier: Apache-2.0
/// rye/loss/ssim.hpp: structural similarity of two images in 0..1, with an 11 x 11 Gaussian window
/// of sigma 1.5 px. Computed as (1 - (mx - my)^2 / (mx^2 + my^2 + C1)) (1 - var(x - y) / (var x +
/// var y + C2)), which is the usual product, but exactly 1 for equal images and never above. In
/// double throughout.
/// Source: Wang et al., "Image Quality Assessment", 2004, eq. 13.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>
#include <type_traits>

#include <rye/backend/backend.hpp>
#include <rye/core/array.hpp>
#include <rye/core/columns.hpp>
#include <rye/core/error.hpp>

namespace rye {

namespace detail {

inline constexpr int ssim_window = 11;    ///< [px]
inline constexpr double ssim_sigma = 1.5; ///< [px]
inline constexpr double ssim_c1 = 1e-4;   ///< (0.01 * peak)^2
inline constexpr double ssim_c2 = 9e-4;   ///< (0.03 * peak)^2

/// Returns the weights along one axis of the window; their sum is 1.
RYE_HD inline Array<double, ssim_window> ssim_weights() {
    Array<double, ssim_window> w{};
    double sum = 0;
    for (int i = 0; i < ssim_window; ++i) {
        const double x = (i - ssim_window / 2) / ssim_sigma;
        sum += w[static_cast<std::size_t>(i)] = std::exp(-0.5 * x * x);
    }
    for (double& x : w) x /= sum;
    return w;
}

/// Five windowed means of a row: x, y, x^2, y^2, (x - y)^2. One array of width * channels each.
using SsimRow = Eigen::Array<double, Eigen::Dynamic, 5>;

/// Returns the five windowed means for row y of the windows.
template <class T>
SsimRow ssim_row(const Image<T>& a, const Image<T>& b, Index y,
                 const Array<double, ssim_window>& weight) {
    const Index c = a.channels(), n = a.width * c, valid = n - (ssim_window - 1) * c;
    SsimRow column = SsimRow::Zero(n, 5), mean = SsimRow::Zero(valid, 5);
    Eigen::ArrayXd p(n), q(n);
    for (int k = 0; k < ssim_window; ++k) {
        const double w = weight[static_cast<std::size_t>(k)];
        p = Eigen::Map<const VecX<T>>(a.pixels.data() + (y + k) * n, n).template cast<double>();
        q = Eigen::Map<const VecX<T>>(b.pixels.data() + (y + k) * n, n).template cast<double>();
        column.col(0) += w * p;
        column.col(1) += w * q;
        column.col(2) += w * p.square();
        column.col(3) += w * q.square();
        column.col(4) += w * (p - q).square();
    }
    for (int k = 0; k < ssim_window; ++k)
        mean += weight[static_cast<std::size_t>(k)] * column.middleRows(k * c, valid);
    return mean;
}

/// Returns the (valid width * channels) values of a row of windows from their means.
inline Eigen::ArrayXd ssim_values(const SsimRow& m) {
    const Eigen::ArrayXd x2 = m.col(0).square(), y2 = m.col(1).square();
    const Eigen::ArrayXd d2 = (m.col(0) - m.col(1)).square();
    // Clamped: means of squares minus squares of means are negative only by rounding.
    const Eigen::ArrayXd var = (m.col(2) - x2).max(0.0) + (m.col(3) - y2).max(0.0);
    const Eigen::ArrayXd var_d = (m.col(4) - d2).max(0.0);
    return (1.0 - d2 / (x2 + y2 + ssim_c1)) * (1.0 - var_d / (var + ssim_c2));
}

} // namespace detail

/// Returns the mean of the map over channels and over the windows that lie inside the image, each
/// weighted by the mask (1 x pixels, or empty for 1 everywhere) at its centre; 1 if no window has
/// weight.
template <class T, Backend B>
double ssim(const B& backend, const Image<T>& a, const Image<T>& b,
            const std::type_identity_t<Columns<T>>& mask) {
    require(a.width == b.width && a.height == b.height && a.channels() == b.channels(), "ssim",
            "images of ", a.width, " x ", a.height, " x ", a.channels(), " and ", b.width, " x ",
            b.height, " x ", b.channels(), " differ in shape");
    require(a.width >= detail::ssim_window && a.height >= detail::ssim_window, "ssim", "got ",
            a.width, " x ", a.height, " pixels, expected at least 11 x 11");
    require(mask.size() == 0 || mask.size() == a.size(), "ssim", "mask has ", mask.size(),
            " pixels, image ", a.size());
    const Array<double, detail::ssim_window> weight = detail::ssim_weights();
    constexpr Index margin = detail::ssim_window / 2;
    const Index c = a.channels(), columns = a.width - 2 * margin;
    const Eigen::Vector2d zero = Eigen::Vector2d::Zero(); // weighted sum, weight
    const Eigen::Vector2d total =
        sum_chunks(backend.threads, a.height - 2 * margin, 8, zero, [&](Index first, Index last) {
            Eigen::Vector2d part = zero;
            for (Index y = first; y < last; ++y) {
                const Eigen::ArrayXd s = detail::ssim_values(detail::ssim_row(a, b, y, weight));
                for (Index x = 0; x < columns; ++x) {
                    const Index centre = (y + margin) * a.width + x + margin;
                    const double m = mask.size() ? static_cast<double>(mask(centre)) : 1.0;
                    if (m == 0) continue;
                    part += m * Eigen::Vector2d(s.segment(x * c, c).sum(), static_cast<double>(c));
                }
            }
            return part;
        });
    return total(1) > 0 ? total(0) / total(1) : 1.0;
}

} // namespace rye
