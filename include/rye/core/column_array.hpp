// SPDX-License-Identifier: Apache-2.0
/// rye/core/column_array.hpp: columns by a pointer, for functions of a point that run on the host
/// and on a device: Eigen's arrays cannot be handed to a kernel.
#pragma once

#include <concepts>
#include <type_traits>

#include <rye/core/columns.hpp>

namespace rye {

/// A view of columns in the host's or a device's memory, laid out as Columns: number r of column c
/// is data[c * rows + r].
template <class T>
struct ColumnArray {
    T* data = nullptr;
    Index rows = 0, cols = 0;

    RYE_HD Index size() const { return rows * cols; }
    template <class U>
        requires(std::same_as<U, const T> && !std::is_const_v<T>)
    RYE_HD operator ColumnArray<U>() const { return {data, rows, cols}; }
};

/// Returns the view of an array.
template <class T>
ColumnArray<T> array_of(Columns<T>& a) {
    return {a.data(), a.rows(), a.cols()};
}
/// The same, to be read.
template <class T>
ColumnArray<const T> array_of(const Columns<T>& a) {
    return {a.data(), a.rows(), a.cols()};
}

namespace detail {

/// Returns column i of an array of 3 rows.
template <class T>
RYE_HD Vec3<std::remove_const_t<T>> column3(T* x, Index i) {
    return Vec3<std::remove_const_t<T>>(x[3 * i], x[3 * i + 1], x[3 * i + 2]);
}
/// Returns column i of an array of 4 rows.
template <class T>
RYE_HD Vec4<std::remove_const_t<T>> column4(T* x, Index i) {
    return Vec4<std::remove_const_t<T>>(x[4 * i], x[4 * i + 1], x[4 * i + 2], x[4 * i + 3]);
}
/// Writes column i of an array of N rows.
template <int N, class T>
RYE_HD void put_column(const Vec<std::type_identity_t<T>, N>& v, T* to, Index i) {
    for (int k = 0; k < N; ++k) to[N * i + k] = v[k];
}
/// Adds to column i of an array of N rows.
template <int N, class T>
RYE_HD void add_column(const Vec<std::type_identity_t<T>, N>& v, T* to, Index i) {
    for (int k = 0; k < N; ++k) to[N * i + k] += v[k];
}

} // namespace detail

} // namespace rye
