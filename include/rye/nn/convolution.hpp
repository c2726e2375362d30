// SPDX-License-Identifier: Apache-2.0
/// rye/nn/convolution.hpp: 3 x 3 convolution with zero padding, and its vjps.
/// A pixel is a column, so the three pixels under a kernel row are 3 C adjacent numbers, and an
/// output row is three products with a matrix of overlapping columns, without an im2col copy.
/// Weights are out x 9 in; column (3 ky + kx) in + i belongs to kernel row ky, column kx, input i.
/// The kernel is not flipped (cross-correlation), as in PyTorch.
#pragma once

#include <algorithm>
#include <array>
#include <vector>

#include <rye/backend/backend.hpp>
#include <rye/core/columns.hpp>
#include <rye/nn/elementwise.hpp>
#include <rye/nn/lanes/convolution.hpp>

namespace rye {

/// An image with a border of one pixel of zeros.
template <class T>
struct Padded {
    int width = 0;     ///< without the border [px]
    int height = 0;    ///< without the border [px]
    Columns<T> pixels; ///< channels x ((width + 2) (height + 2))

    using Neighbours = Eigen::Map<const Columns<T>, 0, Eigen::OuterStride<>>;

    int channels() const { return static_cast<int>(pixels.rows()); }
    /// The pixels of row y: channels x width, adjacent.
    Neighbours row(Index y) const {
        const Index c = pixels.rows();
        return {pixels.data() + ((y + 1) * (width + 2) + 1) * c, c, width,
                Eigen::OuterStride<>(c)};
    }
    /// The three pixels under kernel row ky for each pixel of row y: 3 channels x width.
    Neighbours under(Index y, int ky) const {
        const Index c = pixels.rows();
        return {pixels.data() + (y + ky) * (width + 2) * c, 3 * c, width, Eigen::OuterStride<>(c)};
    }
};

namespace detail {

/// Rows per chunk of an image: about 2048 pixels.
inline Index rows_per_chunk(int width) { return std::max<Index>(1, 2048 / std::max(width, 1)); }

} // namespace detail

/// f(pixel) inside the border, of one image or of several of the same shape.
template <class T, class F, Backend B, class... More>
Padded<T> padded(const B& backend, const Image<T>& in, const F& f, const More&... more) {
    const Index w = in.width, c = in.channels(), pitch = w + 2;
    Padded<T> out{in.width, in.height, Columns<T>(c, pitch * (in.height + 2))};
    out.pixels.leftCols(pitch).setZero();
    out.pixels.rightCols(pitch).setZero();
    for_chunks(backend.threads, in.height, detail::rows_per_chunk(in.width),
               [&](Index b, Index e, Index) {
                   for (Index y = b; y < e; ++y) {
                       const Index row = (y + 1) * pitch;
                       out.pixels.col(row).setZero();
                       out.pixels.col(row + w + 1).setZero();
                       detail::transform_array<B>(w * c, out.pixels.col(row + 1).data(), f,
                                                  in.pixels.data() + y * w * c,
                                                  more.pixels.data() + y * w * c...);
                   }
               });
    return out;
}
/// A copy with a border of zeros.
template <class T, Backend B>
Padded<T> padded(const B& backend, const Image<T>& in) {
    return padded(backend, in, [](const auto& x) { return x; });
}

namespace detail {

/// Returns true if register tiles are faster: outputs fill whole vectors and the weights fit the
/// cache.
template <class B, class T>
bool runs_in_lanes(Index outputs, Index inputs, Index width) {
    if constexpr (LaneBackend<B, T>)
        return outputs % static_cast<Index>(B::template batch<T>::size) == 0 && width >= 8 &&
               outputs * inputs <= 64 * 128;
    else
        return false;
}

} // namespace detail

/// Convolves with weight, out x 9 in. Returns an image of `out` channels.
template <class T, Backend B>
Image<T> convolve3x3(const B& backend, const Columns<T>& weight, const Padded<T>& in) {
    const Index k = 3 * in.channels();
    RYE_ASSERT(weight.cols() == 3 * k, "convolve3x3: weight and image differ in channels");
    Image<T> out;
    out.width = in.width;
    out.height = in.height;
    out.pixels.resize(weight.rows(), out.size());
    const bool lanes = detail::runs_in_lanes<B, T>(weight.rows(), in.channels(), in.width);
    for_chunks(
        backend.threads, in.height, detail::rows_per_chunk(in.width), [&](Index b, Index e, Index) {
            for (Index y = b; y < e; ++y) {
                if constexpr (LaneBackend<B, T>)
                    if (lanes) {
                        detail::convolve_row<typename B::template batch<T>, T>(
                            weight.data(),
                            {in.under(y, 0).data(), in.under(y, 1).data(), in.under(y, 2).data()},
                            out.pixels.col(y * in.width).data(), in.width,
                            {k, in.channels(), weight.rows()});
                        continue;
                    }
                ColumnsSpan<T> row = out.pixels.middleCols(y * in.width, in.width);
                row.noalias() = weight.leftCols(k) * in.under(y, 0);
                row.noalias() += weight.middleCols(k, k) * in.under(y, 1);
                row.noalias() += weight.rightCols(k) * in.under(y, 2);
            }
        });
    return out;
}

/// The weights of the adjoint convolution: in x 9 out, rotated by 180 degrees.
template <class T>
Columns<T> adjoint_weight3x3(const Columns<T>& weight) {
    const Index out = weight.rows(), in = weight.cols() / 9;
    Columns<T> w(in, 9 * out);
    for (Index k = 0; k < 9; ++k)
        w.middleCols(k * out, out) = weight.middleCols((8 - k) * in, in).transpose();
    return w;
}

/// The cotangent of the input, given that of the output.
template <class T, Backend B>
Image<T> convolve3x3_vjp_input(const B& backend, const Columns<T>& weight, const Padded<T>& g) {
    return convolve3x3(backend, adjoint_weight3x3(weight), g);
}
/// The same for a cotangent without a border.
template <class T, Backend B>
Image<T> convolve3x3_vjp_input(const B& backend, const Columns<T>& weight, const Image<T>& g) {
    return convolve3x3_vjp_input(backend, weight, padded(backend, g));
}

/// Adds the cotangent of the weights: partial sums over at most 16 bands of rows, merged in order.
template <class T, Backend B>
void convolve3x3_vjp_weight(const B& backend, const Padded<T>& in, const Padded<T>& g,
                            Columns<T>& g_weight) {
    const Index k = 3 * in.channels();
    const Index rows =
        std::max(detail::rows_per_chunk(in.width), detail::chunk_count(in.height, 16));
    const bool lanes = detail::runs_in_lanes<B, T>(g.channels(), in.channels(), in.width);
    std::vector<Columns<T>> parts(static_cast<std::size_t>(detail::chunk_count(in.height, rows)));
    for_chunks(backend.threads, in.height, rows, [&](Index b, Index e, Index c) {
        Columns<T>& part = parts[static_cast<std::size_t>(c)];
        part.setZero(g_weight.rows(), g_weight.cols());
        for (Index y = b; y < e; ++y) {
            const typename Padded<T>::Neighbours row = g.row(y);
            for (int ky = 0; ky < 3; ++ky) {
                if constexpr (LaneBackend<B, T>)
                    if (lanes) {
                        detail::correlate_row<typename B::template batch<T>, T>(
                            row.data(), in.under(y, ky).data(), in.width, part.col(ky * k).data(),
                            {k, in.channels(), g.channels()});
                        continue;
                    }
                part.middleCols(ky * k, k).noalias() += row * in.under(y, ky).transpose();
            }
        }
    });
    for (const Columns<T>& part : parts) g_weight += part;
}

} // namespace rye
