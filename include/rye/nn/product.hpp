// SPDX-License-Identifier: Apache-2.0
/// rye/nn/product.hpp: products of dense matrices, by a policy that the backend may name:
///
///     struct Mine : rye::XsimdBackend<> { using products = rye::GemmProducts<OpenBlas>; };
///
/// Without one: rye's register tiles where the backend has lanes, else Eigen's. Matrices are
/// column-major. A policy prepares its left factor A once for many right factors:
///
///     set(x), set_transposed(x)           A = x, A = x^T
///     set_and_sum(x, sum)                 A = x, and its columns are added to `sum`
///     times(x, y, put, before)            y = put(row, A x, before)
///     times(x, y, put)                    y = put(row, A x, y)
///     times_transposed(x, y, put)         y = put(row, A x^T, y)
///
/// put(row, sum, before) maps sums to results, `before` being the old value of y or that of a
/// matrix of the same shape and stride. Its arguments are numbers of row `row`, or vectors of rows
/// from `row` on, which may extend beyond the last row.
#pragma once

#include <type_traits>

#include <rye/core/columns.hpp>
#include <rye/nn/elementwise.hpp>
#include <rye/nn/lanes/product_tiles.hpp>

namespace rye {

namespace detail {

/// Left factor whose products are stored before `put`: sums(a, turned, x, out) computes out = a x,
/// or a x^T if turned.
template <Backend B, class T, class Sums>
struct StoredFactor {
    Columns<T> a;

    void set(const ColumnsView<T>& x) { a = x; }
    void set_and_sum(const ColumnsView<T>& x, Columns<T>& sum) {
        a = x;
        for (Index j = 0; j < x.cols(); ++j) sum += x.col(j);
    }
    void set_transposed(const ColumnsView<T>& x) { a = x.transpose(); }
    template <class Put>
    void times(const ColumnsView<T>& x, ColumnsSpan<T> y, const Put& put,
               const ColumnsView<T>& before) const {
        store(x, false, y, put, before);
    }
    template <class Put>
    void times(const ColumnsView<T>& x, ColumnsSpan<T> y, const Put& put) const {
        store(x, false, y, put, y);
    }
    template <class Put>
    void times_transposed(const ColumnsView<T>& x, ColumnsSpan<T> y, const Put& put) const {
        store(x, true, y, put, y);
    }

  private:
    template <class Put>
    void store(const ColumnsView<T>& x, bool turned, ColumnsSpan<T>& y, const Put& put,
               const ColumnsView<T>& before) const {
        Columns<T> sum(y.rows(), y.cols());
        Sums()(a, turned, x, sum);
        for (Index j = 0; j < y.cols(); ++j) {
            const T* const was = before.data() + j * before.outerStride();
            T* const to = y.data() + j * y.outerStride();
            each_vector<B, T>(0, y.rows(), [&]<class V>(std::type_identity<V>, Index i) {
                store_as<V>(put(i, load_as<V>(&sum(i, j)), load_as<V>(was + i)), to + i);
            });
        }
    }
};

} // namespace detail

/// rye's register tiles; for backends with lanes.
struct TileProducts {
    template <Backend B, class T>
        requires LaneBackend<B, T>
    using left_factor = detail::TileFactor<typename B::template batch<T>>;
};

/// Eigen's products.
struct EigenProducts {
    /// out = a x, or a x^T.
    struct Sums {
        template <class T>
        void operator()(const Columns<T>& a, bool turned, const ColumnsView<T>& x,
                        Columns<T>& out) const {
            if (turned)
                out.noalias() = a * x.transpose();
            else
                out.noalias() = a * x;
        }
    };
    template <Backend B, class T>
    using left_factor = detail::StoredFactor<B, T, Sums>;
};

/// A column-major matrix in memory.
template <class T>
struct StridedMatrix {
    T* data;
    Index rows, cols, stride;  ///< stride: from column to column
};

/// Products of a linked library, a BLAS or oneDNN: with T float or double, as the library supports,
///
///     static void Gemm::multiply(const StridedMatrix<const T>& a, const StridedMatrix<const T>& x,
///                                bool x_transposed, const StridedMatrix<T>& y);
///
/// sets y to a x, or to a x^T. Many threads call it at once, so it must not start its own;
/// reproducibility is up to the library.
template <class Gemm>
struct GemmProducts {
    /// out = a x, or a x^T.
    struct Sums {
        template <class T>
        void operator()(const Columns<T>& a, bool turned, const ColumnsView<T>& x,
                        Columns<T>& out) const {
            Gemm::multiply(StridedMatrix<const T>{a.data(), a.rows(), a.cols(), a.outerStride()},
                           StridedMatrix<const T>{x.data(), x.rows(), x.cols(), x.outerStride()},
                           turned,
                           StridedMatrix<T>{out.data(), out.rows(), out.cols(), out.outerStride()});
        }
    };
    template <Backend B, class T>
    using left_factor = detail::StoredFactor<B, T, Sums>;
};

namespace detail {

template <class B, class T>
auto products_of() {
    if constexpr (requires { typename B::products; })
        return std::type_identity<typename B::products>();
    else if constexpr (LaneBackend<B, T>)
        return std::type_identity<TileProducts>();
    else
        return std::type_identity<EigenProducts>();
}

/// Left factor type of the backend's products.
template <Backend B, class T>
using LeftFactor = typename decltype(detail::products_of<B, T>())::type::template left_factor<B, T>;

} // namespace detail

} // namespace rye
