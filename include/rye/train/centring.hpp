// SPDX-License-Identifier: Apache-2.0
/// rye/train/centring.hpp: subtraction of the mean over frames from the frames' corrections. That
/// mean belongs to the avatar: gazes' to kappa, poses' to the head's frame. The same sums on host
/// and device.
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

} // namespace rye
