// SPDX-License-Identifier: Apache-2.0
/// rye/train/centring.hpp: subtraction of what corrections have in common. The mean over frames
/// belongs to the avatar: gazes' to kappa, poses' to the head's frame. So does what all cameras
/// show alike. The same sums on host and device.
#pragma once

#include <concepts>
#include <type_traits>

#include <rye/core/columns.hpp>
#include <rye/core/concepts.hpp>

namespace rye::detail {

/// Returns the mean over columns of a row, given its first number in column-major memory; summed in
/// order, floats in double.
template <class T>
RYE_HD T mean_of_row(const T* row, Index rows, Index cols) {
    using Sum = std::conditional_t<std::same_as<T, float>, double, T>;
    Sum sum = Sum(0);
    for (Index i = 0; i < cols; ++i) sum += Sum(row[i * rows]);
    return T(sum / Sum(static_cast<real_t<Sum>>(cols)));
}

/// Subtracts from each row its mean over columns.
template <class T>
void centre_rows(Columns<T>& a) {
    if (a.cols() == 0) return;
    for (Index k = 0; k < a.rows(); ++k) {
        const T mean = mean_of_row(a.data() + k, a.rows(), a.cols());
        for (Index i = 0; i < a.cols(); ++i) a(k, i) -= mean;
    }
}

/// Returns how much of a mode of view_gauge() all corrections of cameras have, given its column of
/// weights and those corrections, `count` numbers each; summed in order, floats in double.
template <class T>
RYE_HD T shared_mode(const T* weights, const T* delta_view, Index count) {
    using Sum = std::conditional_t<std::same_as<T, float>, double, T>;
    Sum sum = Sum(0);
    for (Index i = 0; i < count; ++i) sum += Sum(weights[i]) * Sum(delta_view[i]);
    return T(sum);
}

/// Returns a number of the corrections of cameras without what they share: `shared` of the modes,
/// given what a unit of each adds to that number, in every `stride`-th place.
template <class T>
RYE_HD T without_shared(T number, const T* motions, Index stride, const T* shared, Index modes) {
    for (Index m = 0; m < modes; ++m) number -= motions[m * stride] * shared[m];
    return number;
}

/// Subtracts from the columns of delta_view what they share by view_gauge(), to first order.
template <class T>
void centre_views(const Columns<T>& gauge, Columns<T>& delta_view) {
    const Index modes = gauge.cols() / 2, count = delta_view.size();
    VecX<T> shared(modes);
    for (Index m = 0; m < modes; ++m)
        shared[m] = shared_mode(gauge.col(m).data(), delta_view.data(), count);
    for (Index i = 0; i < count; ++i)
        delta_view.data()[i] = without_shared(delta_view.data()[i], gauge.col(modes).data() + i,
                                              count, shared.data(), modes);
}

} // namespace rye::detail
