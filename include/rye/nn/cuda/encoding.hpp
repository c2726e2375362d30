// SPDX-License-Identifier: Apache-2.0
/// rye/nn/cuda/encoding.hpp: positional encoding of points in device memory and its vjp, by
/// nn/encoding.hpp's formula of one number, and the bounded features of points.
#pragma once

#include <rye/backend/cuda/each.hpp>
#include <rye/nn/activations.hpp>
#include <rye/nn/encoding.hpp>

namespace rye::detail {

/// Returns the beginning of the codes of number i of columns of `rows` numbers. Numbers are fewer
/// than 2^32, of which a device finds quotients faster.
RYE_DEVICE inline Index code_place(Index i, std::uint32_t rows, int frequencies) {
    const auto k = static_cast<std::uint32_t>(i);
    return static_cast<Index>(k / rows) * encoded_size(static_cast<Index>(rows), frequencies) +
           static_cast<Index>(k % rows);
}

/// Number i of columns of `rows` numbers, and its codes.
struct EncodeNumber {
    static constexpr const char* name = "encoding";
    const float* x;     ///< rows x N
    std::uint32_t rows; ///< numbers are fewer than 2^32
    int frequencies;
    float* code; ///< encoded_size(rows, frequencies) x N

    RYE_DEVICE void operator()(Index i) const {
        encode_number(x[i], frequencies, static_cast<Index>(rows),
                      code + code_place(i, rows, frequencies));
    }
};

/// Adds the cotangent of number i.
struct EncodeNumberVjp {
    static constexpr const char* name = "encoding, reverse";
    const float* code;
    const float* g;     ///< cotangent of the code
    std::uint32_t rows; ///< numbers are fewer than 2^32
    int frequencies;
    float* g_x; ///< rows x N, added to

    RYE_DEVICE void operator()(Index i) const {
        const Index at = code_place(i, rows, frequencies);
        g_x[i] += encode_number_vjp(code + at, g + at, frequencies, static_cast<Index>(rows));
    }
};

/// tanh of number i.
struct TanhNumber {
    static constexpr const char* name = "tanh";
    const float* x;
    float* y;
    RYE_DEVICE float read(Index i) const { return x[i]; }
    RYE_DEVICE void write(Index i, float v) const { y[i] = squash_value(Squash::tanh, v); }
};

/// Adds the cotangent of number i, in terms of its tanh.
struct TanhNumberVjp {
    static constexpr const char* name = "tanh, reverse";
    const float* y;
    const float* g;
    float* g_x; ///< added to
    RYE_DEVICE float read(Index i) const { return g_x[i] + g[i] * tanh_slope(y[i]); }
    RYE_DEVICE void write(Index i, float v) const { g_x[i] = v; }
};

} // namespace rye::detail
