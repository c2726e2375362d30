// SPDX-License-Identifier: Apache-2.0
/// rye/nn/instance_norm.hpp: normalisation of each channel of an image to mean 0 and variance 1,
/// and its vjp. No learned scale, no running statistics. The variance is of centred values, summed
/// in fixed blocks. Source: Ulyanov et al., "Instance Normalization", 2016; eps as in PyTorch.
#pragma once

#include <algorithm>
#include <cmath>

#include <rye/backend/backend.hpp>
#include <rye/core/columns.hpp>
#include <rye/core/concepts.hpp>

namespace rye {

namespace detail {

/// Bounds the gain of a channel that is nearly constant.
inline constexpr double norm_eps = 1e-5;

} // namespace detail

/// x with mean 0 and variance 1: of numbers, or of Eigen's arrays number by number.
template <class X, class M, class G>
RYE_HD auto normalized(const X& x, const M& mean, const G& gain) {
    return (x - mean) * gain;
}
/// The cotangent of x, from g that of y = normalized(x) and the means over pixels of g and g y.
template <class X, class Y, class M, class N, class G>
RYE_HD auto normalized_vjp(const X& g, const Y& y, const M& mean_g, const N& mean_gy,
                           const G& gain) {
    return (g - mean_g - y * mean_gy) * gain;
}

namespace detail {

/// The gain of a channel of that variance.
template <class T>
RYE_HD T norm_gain(const T& variance) {
    using std::sqrt;
    return T(1) / sqrt(variance + T(real_t<T>(norm_eps)));
}

/// Pixels per partial sum: nested sums keep long sums accurate in float.
inline constexpr Index norm_block = 256;

/// Mean over pixels of f(begin, count), a channels x 1 sum over a block of pixels.
template <class T, class F, Backend B>
VecX<T> pixel_mean(const B& backend, Index channels, Index pixels, const F& f) {
    const VecX<T> zero = VecX<T>::Zero(channels);
    const VecX<T> sum = sum_chunks(backend.threads, chunk_count(pixels, norm_block), 16, zero,
                                   [&](Index first, Index last) {
                                       VecX<T> s = zero;
                                       for (Index c = first; c < last; ++c) {
                                           const Index b = c * norm_block;
                                           s += f(b, std::min(norm_block, pixels - b));
                                       }
                                       return s;
                                   });
    return sum * T(1.0 / static_cast<double>(std::max<Index>(pixels, 1)));
}

} // namespace detail

/// Normalises in place; returns 1 / sqrt(variance + eps) of each channel.
template <class T, Backend B>
VecX<T> instance_norm(const B& backend, Columns<T>& x) {
    const VecX<T> mean = detail::pixel_mean<T>(
        backend, x.rows(), x.cols(),
        [&](Index b, Index n) -> VecX<T> { return x.middleCols(b, n).rowwise().sum(); });
    const VecX<T> variance =
        detail::pixel_mean<T>(backend, x.rows(), x.cols(), [&](Index b, Index n) -> VecX<T> {
            VecX<T> s = VecX<T>::Zero(x.rows());
            for (Index j = b; j < b + n; ++j) s += (x.col(j) - mean).cwiseAbs2();
            return s;
        });
    const VecX<T> gain = variance.unaryExpr([](const T& v) { return detail::norm_gain<T>(v); });
    for_chunks(backend.threads, x.cols(), 4096, [&](Index b, Index e, Index) {
        for (Index j = b; j < e; ++j) {
            auto column = x.col(j).array();
            column = normalized(column, mean.array(), gain.array());
        }
    });
    return gain;
}

/// Turns the cotangent of the output y into that of the input, in place.
template <class T, Backend B>
void instance_norm_vjp(const B& backend, const Columns<T>& y, const VecX<T>& gain, Columns<T>& g) {
    const VecX<T> mean_g = detail::pixel_mean<T>(
        backend, y.rows(), y.cols(),
        [&](Index b, Index n) -> VecX<T> { return g.middleCols(b, n).rowwise().sum(); });
    const VecX<T> mean_gy =
        detail::pixel_mean<T>(backend, y.rows(), y.cols(), [&](Index b, Index n) -> VecX<T> {
            VecX<T> s = VecX<T>::Zero(y.rows());
            for (Index j = b; j < b + n; ++j) s += g.col(j).cwiseProduct(y.col(j));
            return s;
        });
    for_chunks(backend.threads, y.cols(), 4096, [&](Index b, Index e, Index) {
        for (Index j = b; j < e; ++j) {
            auto column = g.col(j).array();
            column = normalized_vjp(column, y.col(j).array(), mean_g.array(), mean_gy.array(),
                                    gain.array());
        }
    });
}

} // namespace rye
