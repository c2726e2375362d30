// SPDX-License-Identifier: Apache-2.0
/// rye/nn/lanes/convolution.hpp: inner loops of the 3 x 3 convolution in registers; a lane is an
/// output channel. For few channels a general matrix product spends most time on packing; these
/// tiles read the padded image and the weights unpacked.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <utility>

#include <rye/nn/lanes/register_tile.hpp>

namespace rye::detail {

/// Sizes of the matrix product over the input channels of one kernel row.
struct ConvolutionRow {
    Index inputs;  ///< numbers under a kernel row: 3 channels
    Index step;    ///< numbers per pixel: channels
    Index outputs; ///< output channels
};

/// y[p, :] = sum over the three kernel rows of W x[p, :] for P pixels and V vectors of outputs.
/// w: weights of successive inputs are `outputs` apart. rows: inputs of the first pixel.
template <class Batch, std::size_t V, std::size_t P, class T>
void convolve_tile(const T* w, const std::array<const T*, 3>& rows, T* y, const ConvolutionRow& s) {
    RegisterTile<Batch, V, std::make_index_sequence<P>> tile;
    for (const T* x : rows)
        for (Index i = 0; i < s.inputs; ++i, w += s.outputs) tile.add_product(w, x + i, s.step);
    tile.each(y, s.outputs, [](T* to, const Batch& sum, Index) { sum.store_unaligned(to); });
}

/// g_w[:, i] += sum over a row of pixels of g[p, :] x[p, i] for N inputs and V vectors of outputs.
template <class Batch, std::size_t V, std::size_t N, class T>
void correlate_tile(const T* g, const T* x, Index pixels, T* g_w, const ConvolutionRow& s) {
    RegisterTile<Batch, V, std::make_index_sequence<N>> tile;
    for (Index p = 0; p < pixels; ++p) tile.add_product(g + p * s.outputs, x + p * s.step, 1);
    tile.each(g_w, s.outputs, [](T* to, const Batch& sum, Index) {
        (Batch::load_unaligned(to) + sum).store_unaligned(to);
    });
}

/// One output row, at least 8 pixels wide; outputs are a multiple of the lanes. The last tile ends
/// at the end of the row and may compute some pixels twice, with the same bits.
template <class Batch, class T>
void convolve_row(const T* w, const std::array<const T*, 3>& rows, T* y, Index width,
                  const ConvolutionRow& s) {
    constexpr Index lanes = static_cast<Index>(Batch::size);
    const auto sweep = [&]<std::size_t V, std::size_t N>(Index o) {
        constexpr Index n = static_cast<Index>(N);
        for (Index x = 0; x < width; x += n) {
            const Index at = std::min(x, width - n), offset = at * s.step;
            convolve_tile<Batch, V, N, T>(w + o,
                                          {rows[0] + offset, rows[1] + offset, rows[2] + offset},
                                          y + at * s.outputs + o, s);
        }
    };
    Index o = 0;
    for (; o + 2 * lanes <= s.outputs; o += 2 * lanes) sweep.template operator()<2, 6>(o);
    if (o < s.outputs) sweep.template operator()<1, 8>(o);
}

/// Adds one row of pixels to the cotangent of the weights of one kernel row.
template <class Batch, class T>
void correlate_row(const T* g, const T* x, Index width, T* g_w, const ConvolutionRow& s) {
    constexpr Index lanes = static_cast<Index>(Batch::size);
    const auto sweep = [&]<std::size_t V, std::size_t N>(Index o) {
        constexpr Index n = static_cast<Index>(N);
        Index i = 0;
        for (; i + n <= s.inputs; i += n)
            correlate_tile<Batch, V, N>(g + o, x + i, width, g_w + i * s.outputs + o, s);
        for (; i < s.inputs; ++i)
            correlate_tile<Batch, V, 1>(g + o, x + i, width, g_w + i * s.outputs + o, s);
    };
    Index o = 0;
    for (; o + 2 * lanes <= s.outputs; o += 2 * lanes) sweep.template operator()<2, 6>(o);
    if (o < s.outputs) sweep.template operator()<1, 12>(o);
}

} // namespace rye::detail
