// SPDX-License-Identifier: Apache-2.0
/// rye/train/centring.hpp: subtraction of what corrections have in common. The mean over frames
/// belongs to the avatar: gazes' to kappa, poses' to the head's frame. So does what all cameras
/// show alike. The same sums on host and device.
#pragma once

#include <concepts>
#include <type_traits>

#include <rye/core/columns.hpp>
#include <rye/core/concepts.hpp>

namespace rye {

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

/// Returns a row of the motion that columns of delta_view share, given both in column-major memory;
/// summed in order, floats in double.
template <class T>
RYE_HD T shared_motion(const T* gauge, const T* delta_view, Index cameras, Index row) {
    using Sum = std::conditional_t<std::same_as<T, float>, double, T>;
    const Index part = row / 3;
    Sum sum = Sum(0);
    for (Index c = 0; c < cameras; ++c)
        for (Index j = 0; j < 3; ++j)
            sum += Sum(gauge[9 * (part * cameras + c) + 3 * j + row % 3]) *
                   Sum(delta_view[6 * c + 3 * part + j]);
    return T(sum);
}

/// Subtracts from the columns of delta_view the motion that they share by view_gauge(), to first
/// order.
template <class T>
void centre_views(const Columns<T>& gauge, Columns<T>& delta_view) {
    Vec<T, 6> shared;
    for (Index k = 0; k < 6; ++k)
        shared[k] = shared_motion(gauge.data(), delta_view.data(), delta_view.cols(), k);
    delta_view.colwise() -= shared;
}

} // namespace rye
