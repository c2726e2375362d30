// SPDX-License-Identifier: Apache-2.0
/// rye/nn/lanes/product_tiles.hpp: products of dense matrices in register tiles. The left factor is
/// packed once for many columns of the right one. Each element of the result is one sum in depth
/// order, so its bits depend on its row and column alone.
#pragma once

#include <algorithm>
#include <cstddef>
#include <type_traits>
#include <utility>

#include <rye/core/columns.hpp>
#include <rye/nn/lanes/register_tile.hpp>

namespace rye::detail {

/// The packed left factor: panels of two vectors of rows, the last of one vector where that is
/// enough, zeros below the last row; within a panel, column after column. Unpacked, columns with a
/// stride of a power of two would map to a few cache sets.
template <class Batch>
struct Panels {
    using T = typename Batch::value_type;
    static constexpr Index lanes = static_cast<Index>(Batch::size);
    Index rows = 0, depth = 0;
    VecX<T> data; ///< aligned as Eigen aligns, so that no vector lies across two cache lines

    Index height(Index row) const { return rows - row > lanes ? 2 * lanes : lanes; }
    const T* panel(Index row) const { return data.data() + row * depth; }

    void shape(Index new_rows, Index new_depth) {
        rows = new_rows;
        depth = new_depth;
        data.resize((rows + lanes - 1) / lanes * lanes * depth);
    }
    /// f(panel, its first row, its height)
    template <class F>
    void each_panel(const F& f) {
        for (Index row = 0; row < rows; row += 2 * lanes)
            f(data.data() + row * depth, row, height(row));
    }
};

/// A matrix as the left factor of products, copied into panels of the height of a tile.
template <class Batch>
struct PackedMatrix : Panels<Batch> {
    using T = typename Batch::value_type;
    using Panels<Batch>::lanes, Panels<Batch>::rows, Panels<Batch>::depth;

    /// Packs a column-major matrix; adds its columns to `sum` unless null.
    void pack(const ColumnsView<T>& a, T* sum = nullptr) {
        this->shape(a.rows(), a.cols());
        this->each_panel([&](T* to, Index row, Index h) {
            const T* from = a.data() + row;
            T* const sums = sum == nullptr ? nullptr : sum + row;
            const Index n = std::min(h, rows - row), step = a.outerStride();
            if (n < h) {
                for (Index j = 0; j < depth; ++j, from += step, to += h) {
                    std::copy_n(from, n, to);
                    std::fill_n(to + n, h - n, T(0));
                    for (Index i = 0; sums != nullptr && i < n; ++i) sums[i] += from[i];
                }
                return;
            }
            for (Index i = 0; i < h; i += lanes) {
                Batch column_sum(0);
                for (Index j = 0; j < depth; ++j) {
                    const Batch v = Batch::load_unaligned(from + i + j * step);
                    v.store_unaligned(to + i + j * h);
                    column_sum += v;
                }
                if (sums != nullptr)
                    (Batch::load_unaligned(sums + i) + column_sum).store_unaligned(sums + i);
            }
        });
    }
    /// Packs the transpose of a column-major matrix.
    void pack_transposed(const ColumnsView<T>& a) {
        this->shape(a.cols(), a.rows());
        this->each_panel([&](T* to, Index row, Index h) {
            const Index n = std::min(h, rows - row);
            for (Index i = 0; i < n; ++i)
                for (Index j = 0; j < depth; ++j) to[j * h + i] = a(j, row + i);
            for (Index i = n; i < h; ++i)
                for (Index j = 0; j < depth; ++j) to[j * h + i] = T(0);
        });
    }
};

/// The right factor, not copied: a column-major matrix or its transpose.
template <class T, bool Transposed>
struct RightFactor {
    const T* data;
    Index stride, columns;

    RightFactor(const T* numbers, Index outer_stride, Index n)
        : data(numbers), stride(outer_stride), columns(n) {}
    explicit RightFactor(const ColumnsView<T>& x)
        : RightFactor(x.data(), x.outerStride(), Transposed ? x.rows() : x.cols()) {}
    // The step that is 1 must be a constant: with both variable, the tile runs out of registers.
    Index depth_step() const { return Transposed ? stride : 1; }
    Index column_step() const { return Transposed ? 1 : stride; }
};

/// A packed panel of the left factor.
template <class T>
struct PackedPanel {
    const T* data;
    Index depth;
};

/// Columns [begin, end) of the product.
struct ProductColumns {
    Index begin, end;
};

/// Columns `stride` apart that receive a product.
template <class T>
struct ProductTarget {
    T* data;
    Index stride;
};

/// V vectors of rows by N columns of the product, from column c on. Not inlined: the caller's code
/// would take the registers of the addresses.
template <class Batch, std::size_t V, std::size_t N, bool Transposed, class T, class Put>
[[gnu::noinline]] void product_tile(PackedPanel<T> a, const RightFactor<T, Transposed>& x, Index c,
                                    ProductTarget<T> y, const Put& put) {
    RegisterTile<Batch, V, std::make_index_sequence<N>> tile;
    const T* b = x.data + c * x.column_step();
    constexpr Index height = static_cast<Index>(V * Batch::size);
    for (Index j = 0; j < a.depth; ++j, a.data += height, b += x.depth_step())
        tile.add_product(a.data, b, x.column_step());
    tile.each(y.data, y.stride, put);
}

/// A panel times columns [c, end) of X; y points to column c. A remainder of two-vector
/// panels is one tile: two narrower ones would each wait for their sums.
template <class Batch, std::size_t V, std::size_t N, bool Transposed, class T, class Put>
void product_panel(PackedPanel<T> a, const RightFactor<T, Transposed>& x, ProductColumns columns,
                   ProductTarget<T> y, const Put& put) {
    constexpr Index n = static_cast<Index>(N);
    auto& [c, end] = columns;
    for (; c + n <= end; c += n, y.data += n * y.stride)
        product_tile<Batch, V, N, Transposed>(a, x, c, y, put);
    if constexpr (N > 1)
        if (c < end)
            product_panel<Batch, V, V == 2 ? N - 1 : N / 2, Transposed>(a, x, columns, y, put);
}

/// y = put(row, A x, before), on vectors of rows that begin at `row`; `before` is y itself or a
/// matrix of its shape and stride.
template <class Batch, bool Transposed, class T, class Put>
void packed_product(const Panels<Batch>& a, const RightFactor<T, Transposed>& x, ColumnsSpan<T> y,
                    const Put& put, const std::type_identity_t<ColumnsView<T>>& before) {
    constexpr Index lanes = static_cast<Index>(Batch::size), block = 12;
    const Index ld = y.outerStride();
    RYE_ASSERT(before.outerStride() == ld || y.cols() < 2, "packed_product: strides differ");
    // `from` points into `before` at the element that `to` points to in y.
    const auto panel = [&]<std::size_t V>(Index row, Index begin, Index end, T* to, const T* from,
                                          Index step) {
        detail::product_panel<Batch, V, 12 / V, Transposed>(
            detail::PackedPanel<T>{a.panel(row), a.depth}, x, {begin, end},
            detail::ProductTarget<T>{to, step},
            [&](T* at, const Batch& sum, Index below) {
                put(row + below, sum, Batch::load_unaligned(from + (at - to))).store_unaligned(at);
            });
    };
    const auto any_height = [&](Index row, auto... rest) {
        if (a.height(row) > lanes)
            panel.template operator()<2>(row, rest...);
        else
            panel.template operator()<1>(row, rest...);
    };
    for (Index row = 0; row < a.rows; row += 2 * lanes) {
        const Index height = a.height(row), here = std::min(height, a.rows - row);
        if (here == height) {
            any_height(row, Index(0), x.columns, y.data() + row, before.data() + row, ld);
            continue;
        }
        // Last rows that do not fill a vector go through a local buffer.
        alignas(64) T own[std::size_t(block * 2 * lanes)] = {};
        for (Index c = 0; c < x.columns; c += block) {
            const Index n = std::min(block, x.columns - c);
            for (Index k = 0; k < n; ++k)
                std::copy_n(before.data() + (c + k) * ld + row, here, own + k * height);
            any_height(row, c, c + n, own, static_cast<const T*>(own), height);
            for (Index k = 0; k < n; ++k) std::copy_n(own + k * height, here, &y(row, c + k));
        }
    }
}

/// Left factor in panels, see product.hpp.
template <class Batch>
struct TileFactor {
    using T = typename Batch::value_type;
    PackedMatrix<Batch> a;

    void set(const ColumnsView<T>& x) { a.pack(x); }
    void set_and_sum(const ColumnsView<T>& x, Columns<T>& sum) { a.pack(x, sum.data()); }
    void set_transposed(const ColumnsView<T>& x) { a.pack_transposed(x); }
    template <class Put>
    void times(const ColumnsView<T>& x, ColumnsSpan<T> y, const Put& put,
               const ColumnsView<T>& before) const {
        packed_product(a, RightFactor<T, false>(x), y, put, before);
    }
    template <class Put>
    void times(const ColumnsView<T>& x, ColumnsSpan<T> y, const Put& put) const {
        packed_product(a, RightFactor<T, false>(x), y, put, y);
    }
    template <class Put>
    void times_transposed(const ColumnsView<T>& x, ColumnsSpan<T> y, const Put& put) const {
        packed_product(a, RightFactor<T, true>(x), y, put, y);
    }
};

} // namespace rye::detail
