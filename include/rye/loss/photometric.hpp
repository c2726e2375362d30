// SPDX-License-Identifier: Apache-2.0
/// rye/loss/photometric.hpp: pixel-wise differences of two images: L1 with its gradient, mean
/// squared error and PSNR. A mask weights pixels; an empty mask is 1 everywhere.
/// Source: the L1 terms of Gaussian Head Avatar and RYE, which divide by *all* pixels and channels.
#pragma once

#include <cmath>
#include <limits>
#include <string>
#include <type_traits>

#include <rye/autodiff/widen.hpp>
#include <rye/backend/backend.hpp>
#include <rye/core/columns.hpp>
#include <rye/core/concepts.hpp>
#include <rye/core/error.hpp>

namespace rye {

/// Loss, and its cotangent of the first image.
template <class T>
struct LossGradient {
    T value = T(0);
    Columns<T> gradient; ///< of the shape of the first image
};

namespace detail {

/// Number of pixels per partial sum.
inline constexpr Index loss_grain = 1024;

template <class T>
void require_same_shape(const char* who, const ColumnsView<T>& a, const ColumnsView<T>& b,
                        const ColumnsView<T>& mask) {
    const auto text = [](const ColumnsView<T>& m) {
        return std::to_string(m.rows()) + " x " + std::to_string(m.cols());
    };
    require(
        a.rows() == b.rows() && a.cols() == b.cols(), who, "images ", [&] { return text(a); },
        " and ", [&] { return text(b); }, " differ in shape");
    require(
        mask.size() == 0 || (mask.rows() == 1 && mask.cols() == a.cols()), who, "mask is ",
        [&] { return text(mask); }, ", expected 1 x ", a.cols());
}

/// Mask and weight of a loss.
template <class T>
struct WeightedMask {
    const Columns<T>& mask;  ///< 1 x pixels, or empty for 1 everywhere
    T weight;
};

} // namespace detail

/// Absolute difference of one masked number: |d|, and its share of a cotangent of slope s:
/// sign(d) s.
template <class T>
struct AbsoluteDifference {
    T d;

    RYE_HD AbsoluteDifference(const T& mask, const T& a, const T& b) : d(mask * (a - b)) {}
    RYE_HD T value() const {
        using std::abs;
        return T(abs(d));
    }
    RYE_HD T cotangent(const T& slope) const {
        const int sign = int(d > T(0)) - int(d < T(0)); // without a branch
        return T(static_cast<real_t<T>>(sign)) * slope;
    }
};

/// Returns mean |mask (a - b)| over all pixels and channels, masked or not; its slope at 0 is 0.
/// Adds `weight` times its cotangent of a to g. a, b, g: channels x pixels.
template <class T, Backend B>
T add_masked_l1(const B& backend, const std::type_identity_t<ColumnsView<T>>& a,
                const std::type_identity_t<ColumnsView<T>>& b,
                const std::type_identity_t<detail::WeightedMask<T>>& weighted,
                std::type_identity_t<ColumnsSpan<T>> g) {
    const Columns<T>& mask = weighted.mask;
    const T& weight = weighted.weight;
    using W = detail::widened_t<T>; // float does not resolve a mean over millions of values
    detail::require_same_shape<T>("masked_l1", a, b, mask);
    if (a.size() == 0) return T(0);
    const T share(static_cast<real_t<T>>(1.0 / static_cast<double>(a.size())));
    const Index channels = a.rows();
    const W sum = sum_chunks(
        backend.threads, a.cols(), detail::loss_grain, W(0), [&](Index first, Index last) {
            W total(0);
            for (Index j = first; j < last; ++j) {
                const T m = mask.size() ? mask(j) : T(1);
                if (m == T(0)) continue; // masked pixels may hold NaN
                const T *const p = a.data() + j * a.outerStride(),
                        *const q = b.data() + j * b.outerStride();
                T* const to = g.data() + j * g.outerStride();
                const T slope = weight * T(m * share);
                W pixel(0);
                for (Index i = 0; i < channels; ++i) {
                    const AbsoluteDifference<T> d(m, p[i], q[i]);
                    pixel += detail::scalar_cast<W>(d.value());
                    to[i] += d.cotangent(slope);
                }
                total += pixel;
            }
            return total;
        });
    return detail::scalar_cast<T>(W(sum * W(1.0 / static_cast<double>(a.size()))));
}

/// Returns the mean absolute difference over C channels, weighted by a mask (1 x pixels), and its
/// gradient with respect to a.
template <class T, Backend B>
LossGradient<T> masked_l1(const B& backend, const std::type_identity_t<ColumnsView<T>>& a,
                          const std::type_identity_t<ColumnsView<T>>& b, const Columns<T>& mask) {
    detail::require_same_shape<T>("masked_l1", a, b, mask);
    LossGradient<T> loss{T(0), Columns<T>::Zero(a.rows(), a.cols())};
    loss.value = add_masked_l1<T>(backend, a, b, {mask, T(1)}, loss.gradient);
    return loss;
}

/// Returns the mean of (a - b)^2 over pixels and channels, weighted by the mask, in double; 0 if
/// the mask is 0 everywhere.
template <class T>
double mean_squared_error(const std::type_identity_t<ColumnsView<T>>& a,
                          const std::type_identity_t<ColumnsView<T>>& b, const Columns<T>& mask) {
    detail::require_same_shape<T>("mean_squared_error", a, b, mask);
    double sum = 0, weight = 0;
    for (Index j = 0; j < a.cols(); ++j) {
        const double m = mask.size() ? static_cast<double>(mask(j)) : 1.0;
        if (m == 0) continue; // masked pixels may hold NaN
        sum +=
            m * (a.col(j).template cast<double>() - b.col(j).template cast<double>()).squaredNorm();
        weight += m * static_cast<double>(a.rows());
    }
    return weight > 0 ? sum / weight : 0.0;
}

/// Returns 10 log10(peak^2 / mean squared error) [dB]; +infinity for equal images.
template <class T>
double psnr(const std::type_identity_t<ColumnsView<T>>& a,
            const std::type_identity_t<ColumnsView<T>>& b, const Columns<T>& mask,
            double peak = 1.0) {
    const double mse = mean_squared_error<T>(a, b, mask);
    return mse > 0 ? 10.0 * std::log10(peak * peak / mse) : std::numeric_limits<double>::infinity();
}

} // namespace rye
