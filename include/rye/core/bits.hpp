// SPDX-License-Identifier: Apache-2.0
/// rye/core/bits.hpp: bitwise equality of numbers and of arrays. Unlike ==, a NaN equals itself and
/// -0 differs from 0, so equal inputs give equal results.
#pragma once

#include <cstring>
#include <vector>

#include <rye/core/columns.hpp>
#include <rye/core/concepts.hpp>

namespace rye {

/// Returns true if two numbers have the same bits: NaNs may be equal, 0 and -0 are not.
template <Real T>
bool same_bits(const T& a, const T& b) {
    return std::memcmp(&a, &b, sizeof(T)) == 0;
}

/// Returns true if two matrices have the same shape and the same bits.
template <Real T, int R, int C>
bool same_bits(const Eigen::Matrix<T, R, C>& a, const Eigen::Matrix<T, R, C>& b) {
    return a.rows() == b.rows() && a.cols() == b.cols() &&
           (a.size() == 0 ||
            std::memcmp(a.data(), b.data(), sizeof(T) * static_cast<std::size_t>(a.size())) == 0);
}

/// Returns true where two lists have the same length and the same bits.
template <Real T>
bool same_bits(const std::vector<T>& a, const std::vector<T>& b) {
    return a.size() == b.size() &&
           (a.empty() || std::memcmp(a.data(), b.data(), sizeof(T) * a.size()) == 0);
}

} // namespace rye
