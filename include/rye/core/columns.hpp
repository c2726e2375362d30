// SPDX-License-Identifier: Apache-2.0
/// rye/core/columns.hpp: the one array layout: a column per point, or per pixel.
/// A quantity of D numbers for N points is a D x N matrix, column-major, so a point's numbers are
/// adjacent. An image of C channels is the same with a column per pixel (row by row), so that an
/// MLP over points, a convolution over pixels and the blending of features share their products.
#pragma once

#include <vector>

#include <rye/core/eigen.hpp>

#include <rye/core/config.hpp>

#if !EIGEN_VERSION_AT_LEAST(3, 4, 0)
#error "rye: got an older Eigen, expected 3.4 or newer"
#endif

namespace rye {

/// A column a point or pixel, a row a component; column-major.
template <class T>
using Columns = Eigen::Matrix<T, Eigen::Dynamic, Eigen::Dynamic>;

/// A read-only view of columns: a whole matrix or a block of columns or rows, without a copy.
template <class T>
using ColumnsView = Eigen::Ref<const Columns<T>, 0, Eigen::OuterStride<>>;

/// A writable view of columns.
template <class T>
using ColumnsSpan = Eigen::Ref<Columns<T>, 0, Eigen::OuterStride<>>;

/// N numbers.
template <class T, int N>
using Vec = Eigen::Matrix<T, N, 1>;
/// Two numbers.
template <class T>
using Vec2 = Vec<T, 2>;
/// Three numbers.
template <class T>
using Vec3 = Vec<T, 3>;
/// Four numbers.
template <class T>
using Vec4 = Vec<T, 4>;
/// Numbers of a count known at run time.
template <class T>
using VecX = Eigen::Matrix<T, Eigen::Dynamic, 1>;
/// R x C numbers, column-major.
template <class T, int R, int C>
using Mat = Eigen::Matrix<T, R, C>;
/// 3 x 3 numbers, column-major.
template <class T>
using Mat3 = Mat<T, 3, 3>;

/// Returns columns which[0], which[1], ... of `all`.
template <class T>
Columns<T> pick_columns(const Columns<T>& all, const std::vector<Index>& which) {
    Columns<T> r(all.rows(), static_cast<Index>(which.size()));
    for (std::size_t k = 0; k < which.size(); ++k) r.col(static_cast<Index>(k)) = all.col(which[k]);
    return r;
}

/// An image: channels x (width * height), pixel (x, y) in column y * width + x, top row first.
/// Pixel (x, y) covers [x, x+1) x [y, y+1); its centre is (x + 0.5, y + 0.5).
template <class T>
struct Image {
    int width = 0;      ///< [px]
    int height = 0;     ///< [px]
    Columns<T> pixels;  ///< channels x (width * height)

    Image() = default;
    Image(int w, int h, int channels, const T& fill = T(0))
        : width(w), height(h),
          pixels(Columns<T>::Constant(channels, static_cast<Index>(w) * h, fill)) {}

    int channels() const { return static_cast<int>(pixels.rows()); }
    Index size() const { return static_cast<Index>(width) * height; }
    auto at(int x, int y) { return pixels.col(static_cast<Index>(y) * width + x); }
    auto at(int x, int y) const { return pixels.col(static_cast<Index>(y) * width + x); }
};

} // namespace rye
