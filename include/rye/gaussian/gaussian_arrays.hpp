// SPDX-License-Identifier: Apache-2.0
/// rye/gaussian/gaussian_arrays.hpp: Gaussians by pointers, in the host's memory or a device's.
#pragma once

#include <concepts>
#include <type_traits>

#include <rye/core/column_array.hpp>
#include <rye/gaussian/gaussians.hpp>

namespace rye {

namespace detail {

/// Views of the arrays of Gaussians<T>, or of a range of their columns.
template <class T>
struct GaussianArrays {
    ColumnArray<T> mean, rotation, scale, opacity, feature;

    RYE_HD Index count() const { return mean.cols; }
    RYE_HD Index channels() const { return feature.rows; }
    template <class U>
        requires(std::same_as<U, const T> && !std::is_const_v<T>)
    RYE_HD operator GaussianArrays<U>() const { return {mean, rotation, scale, opacity, feature}; }
};

} // namespace detail

/// Returns the views of a cloud's arrays.
template <class T>
detail::GaussianArrays<T> arrays_of(Gaussians<T>& g) {
    return {array_of(g.mean), array_of(g.rotation), array_of(g.scale), array_of(g.opacity),
            array_of(g.feature)};
}
/// The same, to be read.
template <class T>
detail::GaussianArrays<const T> arrays_of(const Gaussians<T>& g) {
    return {array_of(g.mean), array_of(g.rotation), array_of(g.scale), array_of(g.opacity),
            array_of(g.feature)};
}

namespace detail {

/// Returns the views of a range of columns.
template <class T>
GaussianArrays<T> columns_from(const GaussianArrays<T>& g, const ColumnRange& range) {
    const auto part = [&](const ColumnArray<T>& a) -> ColumnArray<T> {
        return {a.data + range.begin * a.rows, a.rows, range.count};
    };
    return {part(g.mean), part(g.rotation), part(g.scale), part(g.opacity), part(g.feature)};
}

} // namespace detail

} // namespace rye
