// SPDX-License-Identifier: Apache-2.0
/// rye/nn/product_bf16.hpp: products of factors rounded to bfloat16, summed in float. A policy of
/// accuracy: the products of a row and a column are off by up to 2^-8 of their size, each sum by
/// what it has of them. Weights and gradients stay float.
#pragma once

#include <algorithm>
#include <type_traits>
#include <vector>

#include <rye/backend/bf16.hpp>
#include <rye/nn/product.hpp>

namespace rye {

namespace detail {

/// Where numbers of a matrix or its transpose lie.
struct Strided {
    const float* data;
    Index row_step, column_step;

    static Strided of(const ColumnsView<float>& x) { return {x.data(), 1, x.outerStride()}; }
    Strided transposed() const { return {data, column_step, row_step}; }
    /// Numbers (row, 2 pair) and (row, 2 pair + 1) of a matrix with `depth` columns.
    Bf16Pair pair(Index row, Index pair, Index depth) const {
        const float* const p = data + row * row_step + 2 * pair * column_step;
        return Bf16Pair::of(*p, 2 * pair + 1 < depth ? p[column_step] : 0.F);
    }
};

} // namespace detail

template <class Batch, bool Instruction>
struct Bf16Factor {
    Panels<Bf16Pairs<Batch, Instruction>> a;

    void set(const ColumnsView<float>& x) { pack(detail::Strided::of(x), x.rows(), x.cols()); }
    void set_and_sum(const ColumnsView<float>& x, Columns<float>& sum) {
        set(x);
        for (Index j = 0; j < x.cols(); ++j) sum += x.col(j);
    }
    void set_transposed(const ColumnsView<float>& x) {
        pack(detail::Strided::of(x).transposed(), x.cols(), x.rows());
    }
    template <class Put>
    void times(const ColumnsView<float>& x, ColumnsSpan<float> y, const Put& put,
               const ColumnsView<float>& before) const {
        product(detail::Strided::of(x).transposed(), x.rows(), y, put, before);
    }
    template <class Put>
    void times(const ColumnsView<float>& x, ColumnsSpan<float> y, const Put& put) const {
        product(detail::Strided::of(x).transposed(), x.rows(), y, put, y);
    }
    template <class Put>
    void times_transposed(const ColumnsView<float>& x, ColumnsSpan<float> y, const Put& put) const {
        product(detail::Strided::of(x), x.cols(), y, put, y);
    }

  private:
    void pack(const detail::Strided& x, Index rows, Index depth) {
        a.shape(rows, (depth + 1) / 2);
        a.each_panel([&](Bf16Pair* to, Index row, Index height) {
            for (Index j = 0; j < a.depth; ++j)
                for (Index i = 0; i < height; ++i, ++to)
                    *to = row + i < rows ? x.pair(row + i, j, depth) : Bf16Pair{0};
        });
    }
    /// x: a row for each column of the right factor.
    template <class Put>
    void product(const detail::Strided& x, Index depth, ColumnsSpan<float>& y, const Put& put,
                 const ColumnsView<float>& before) const {
        std::vector<Bf16Pair> right(static_cast<std::size_t>(a.depth * y.cols()));
        for (Index c = 0; c < y.cols(); ++c)
            for (Index j = 0; j < a.depth; ++j)
                right[static_cast<std::size_t>(c * a.depth + j)] = x.pair(c, j, depth);
        packed_product(a, RightFactor<Bf16Pair, false>(right.data(), a.depth, y.cols()), y, put,
                       before);
    }
};

/// For backends with lanes and networks of float.
template <bool Instruction>
struct Bf16ProductsBy {
    template <Backend B, class T>
        requires LaneBackend<B, T> && std::is_same_v<T, float>
    using left_factor = Bf16Factor<typename B::template batch<T>, Instruction>;
};
using Bf16Products = Bf16ProductsBy<Bf16Instruction::value>;

} // namespace rye
