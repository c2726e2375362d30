// SPDX-License-Identifier: Apache-2.0
/// rye/gaussian/view.hpp: views of Gaussians for a renderer: a whole cloud, a range of its columns,
/// its first channels, or another program's buffers, interleaved or apart. Copies nothing. World
/// frame, activated, as Gaussians (gaussian/gaussians.hpp); a column per Gaussian.
#pragma once

#include <cstdint>
#include <string>

#include <rye/core/error.hpp>
#include <rye/gaussian/gaussians.hpp>

namespace rye {

/// Returns the stride, in numbers of T, from one Record of an array to the next, for views of
/// interleaved memory.
template <class T, class Record>
constexpr Index stride_in() {
    static_assert(sizeof(Record) % sizeof(T) == 0,
                  "the size of a record is not a whole number of the view's numbers");
    return static_cast<Index>(sizeof(Record) / sizeof(T));
}

namespace detail {

/// Read-only columns of Rows numbers each, in memory of any stride. A pointer converts to it:
/// columns one after another.
template <class T, int Rows>
struct ViewColumns {
    const T* data = nullptr; ///< the first column
    Index stride = Rows;     ///< numbers from one column to the next, >= Rows or negative

    ViewColumns() = default;
    ViewColumns(const T* first, Index numbers = Rows) // NOLINT(google-explicit-constructor)
        : data(first),
          stride(numbers) {}
    /// Returns the Rows numbers of column i.
    const T* operator()(Index i) const { return data + stride * i; }
    /// Returns columns from `begin` on.
    ViewColumns from(Index begin) const { return {data + stride * begin, stride}; }
};

} // namespace detail

/// Read-only columns of Gaussians. The memory must outlive the view; functions take it by
/// reference, and a Gaussians<T> converts to it:
///     rasterizer.forward(backend, cloud, camera, background);
///     rasterizer.forward(backend, view_of(cloud).columns(0, n).first_channels(3), camera, white);
/// Records of a host program, without a copy:
///     GaussianView<float> v;
///     v.mean = {vertices[0].position, stride_in<float, Vertex>()};   // rotation, ... likewise
///     v.feature = vertices[0].rgb, v.stride = stride_in<float, Vertex>(), v.rows = 3, v.size = n;
template <class T>
struct GaussianView {
    detail::ViewColumns<T, 3> mean; ///< 3 x N  [world units]
    detail::ViewColumns<T, 4>
        rotation; ///< 4 x N  quaternions (w, x, y, z) of any norm; 0: identity
    detail::ViewColumns<T, 3>
        scale; ///< 3 x N  standard deviations along the own axes [world units]
    detail::ViewColumns<T, 1> opacity; ///< 1 x N  in 0..1
    const T* feature = nullptr;  ///< C x N, `stride` numbers from one Gaussian to the next
    Index size = 0;              ///< N
    Index rows = 0;              ///< C
    Index stride = 0;            ///< >= C

    GaussianView() = default;
    /// Implicit, so that functions of a view accept a cloud. Throws an Error unless every array of
    /// `g` has its number of rows and one column per Gaussian.
    GaussianView(const Gaussians<T>& g) // NOLINT(google-explicit-constructor)
        : mean(g.mean.data()), rotation(g.rotation.data()), scale(g.scale.data()),
          opacity(g.opacity.data()), feature(g.feature.data()), size(g.count()), rows(g.channels()),
          stride(g.channels()) {
        detail::check_shapes("rasterizer", g);
    }

    Index count() const { return size; }
    Index channels() const { return rows; }
    const T* feature_of(Index i) const { return feature + i * stride; }

    /// Returns columns [begin, begin + n). Throws an Error if there are fewer.
    GaussianView columns(Index begin, Index n) const {
        require(begin >= 0 && n >= 0 && begin <= size - n, "GaussianView", "got columns ", begin,
                " to ", begin + n, " of ", size);
        GaussianView v = *this;
        v.mean = mean.from(begin);
        v.rotation = rotation.from(begin);
        v.scale = scale.from(begin);
        v.opacity = opacity.from(begin);
        v.feature += stride * begin;
        v.size = n;
        return v;
    }
    /// Returns the first n channels. Throws an Error if there are fewer.
    GaussianView first_channels(Index n) const {
        require(n >= 0 && n <= rows, "GaussianView", "got ", n, " of ", rows, " channels");
        GaussianView v = *this;
        v.rows = n;
        return v;
    }
};

/// Returns a view of a whole cloud.
template <class T>
GaussianView<T> view_of(const Gaussians<T>& g) {
    return g;
}

/// Returns a copy of the viewed Gaussians.
template <class T>
Gaussians<T> copy_of(const GaussianView<T>& v) {
    Gaussians<T> g(v.count(), v.channels());
    for (Index i = 0; i < v.count(); ++i) {
        std::copy_n(v.mean(i), 3, g.mean.data() + 3 * i);
        std::copy_n(v.rotation(i), 4, g.rotation.data() + 4 * i);
        std::copy_n(v.scale(i), 3, g.scale.data() + 3 * i);
        std::copy_n(v.opacity(i), 1, g.opacity.data() + i);
        std::copy_n(v.feature_of(i), v.channels(), g.feature.data() + i * v.channels());
    }
    return g;
}

/// Writable columns of Gaussians of fixed shape. Copies nothing.
template <class T>
struct GaussianSpan {
    ColumnsSpan<T> mean, rotation, scale, opacity, feature;

    Index count() const { return mean.cols(); }
    Index channels() const { return feature.rows(); }
};

namespace detail {

/// Returns the first n columns.
template <class T>
GaussianSpan<T> first_columns(Gaussians<T>& g, Index n) {
    return {g.mean.leftCols(n), g.rotation.leftCols(n), g.scale.leftCols(n), g.opacity.leftCols(n),
            g.feature.leftCols(n)};
}

} // namespace detail

} // namespace rye
