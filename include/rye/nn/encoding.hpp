// SPDX-License-Identifier: Apache-2.0
/// rye/nn/encoding.hpp: positional encoding of points, poses and angles.
/// [x, sin x, cos x, sin 2x, cos 2x, sin 4x, cos 4x, ...], each block the whole vector, so D
/// numbers become D (1 + 2 F). The frequencies are powers of two, so their arguments are exact.
/// Source: Mildenhall et al., "NeRF", 2020, eq. 4, with the identity and without the factor pi.
#pragma once

#include <cmath>
#include <concepts>

#include <rye/backend/backend.hpp>
#include <rye/core/columns.hpp>
#include <rye/core/error.hpp>

namespace rye {

namespace detail {

/// Frequencies 1, 2, 4, 8, as in Gaussian Head Avatar.
inline constexpr int default_frequencies = 4;

/// Rows of the code of so many values.
RYE_HD constexpr Index encoded_size(Index values, int frequencies) {
    return values * (1 + 2 * frequencies);
}

/// Encodes one component of a vector of `size`: writes its 1 + 2 F numbers, `size` apart. Uses the
/// library's sine; whole arrays below use Eigen's, which may differ in the last bits.
template <Scalar T>
RYE_HD void encode_number(const T& x, int frequencies, Index size, T* y) {
    using std::cos, std::sin;
    T scaled = x;                                                         // 2^k x
    y[0] = x;
    for (int k = 0; k < frequencies; ++k) {
        y[(1 + 2 * k) * size] = sin(scaled);
        y[(2 + 2 * k) * size] = cos(scaled);
        scaled = scaled + scaled;
    }
}

/// Its cotangent, in terms of the encoding.
template <Scalar T>
RYE_HD T encode_number_vjp(const T* y, const T* g, int frequencies, Index size) {
    T sum = g[0], rate = T(1);                                            // 2^k
    for (int k = 0; k < frequencies; ++k) {
        const Index s = (1 + 2 * k) * size, c = s + size;
        sum += rate * (g[s] * y[c] - g[c] * y[s]);
        rate = rate + rate;
    }
    return sum;
}

} // namespace detail

/// Encodes x, D x N; returns D (1 + 2 F) x N.
template <class X>
Columns<typename X::Scalar> positional_encoding(const Eigen::MatrixBase<X>& x,
                                                int frequencies = detail::default_frequencies) {
    using T = typename X::Scalar;
    const Index d = x.rows();
    Columns<T> y(detail::encoded_size(d, frequencies), x.cols());
    Columns<T> scaled = x, turned; // 2^k x
    y.topRows(d) = scaled;
    for (int k = 0; k < frequencies; ++k) {
        // Whole arrays, as Eigen does not vectorise blocks of a few rows.
        turned = scaled.array().sin().matrix();
        y.middleRows(d * (1 + 2 * k), d) = turned;
        turned = scaled.array().cos().matrix();
        y.middleRows(d * (2 + 2 * k), d) = turned;
        scaled += scaled.eval();
    }
    return y;
}

/// The cotangent of x (D x N), in terms of the encoding, which holds every sine and cosine.
template <class Y, class G>
Columns<typename Y::Scalar> positional_encoding_vjp(const Eigen::MatrixBase<Y>& y,
                                                    const Eigen::MatrixBase<G>& g,
                                                    int frequencies = detail::default_frequencies) {
    using T = typename Y::Scalar;
    const Index d = y.rows() / detail::encoded_size(1, frequencies);
    RYE_ASSERT(y.rows() == detail::encoded_size(d, frequencies) && g.rows() == y.rows() &&
                   g.cols() == y.cols(),
               "positional_encoding_vjp: y and g differ in shape");
    Columns<T> gx = g.topRows(d);
    for (int k = 0; k < frequencies; ++k) {
        const Index s = d * (1 + 2 * k), c = s + d; // rows of sin, of cos
        gx += T(std::ldexp(1.0, k)) * (g.middleRows(s, d).cwiseProduct(y.middleRows(c, d)) -
                                       g.middleRows(c, d).cwiseProduct(y.middleRows(s, d)));
    }
    return gx;
}

/// Encoding of a network's inputs: D numbers to size(D, F), column by column, and the cotangent of
/// the numbers in terms of the code.
template <class C>
concept Encoding = requires(const Columns<float>& x) {
    { C::size(Index(3), 4) } -> std::convertible_to<Index>;
    { C::encode(x, 4) } -> std::convertible_to<Columns<float>>;
    { C::vjp(x, x, 4) } -> std::convertible_to<Columns<float>>;
};

/// The default encoding: the numbers, and sines and cosines at frequencies 1, 2, 4, ...
struct PositionalEncoding {
    static constexpr Index size(Index values, int frequencies) {
        return detail::encoded_size(values, frequencies);
    }
    template <class X>
    static Columns<typename X::Scalar> encode(const X& x, int frequencies) {
        return positional_encoding(x, frequencies);
    }
    template <class Y, class G>
    static Columns<typename Y::Scalar> vjp(const Y& code, const G& g, int frequencies) {
        return positional_encoding_vjp(code, g, frequencies);
    }
};
static_assert(Encoding<PositionalEncoding>);

/// Encodes many points on the backend's threads, in chunks of 1024 columns (whole vectors).
template <Encoding C = PositionalEncoding, class T, Backend B>
void encode_points(const B& backend, const Columns<T>& x, int frequencies, Columns<T>& y) {
    y.resize(C::size(x.rows(), frequencies), x.cols());
    for_chunks(backend.threads, x.cols(), 256, [&](Index b, Index e, Index) {
        y.middleCols(b, e - b) = C::encode(x.middleCols(b, e - b), frequencies);
    });
}

/// Adds the cotangents of many points to g_x.
template <Encoding C = PositionalEncoding, class T, Backend B>
void encode_points_vjp(const B& backend, const Columns<T>& y, const Columns<T>& g, int frequencies,
                       Columns<T>& g_x) {
    for_chunks(backend.threads, y.cols(), 256, [&](Index b, Index e, Index) {
        g_x.middleCols(b, e - b) +=
            C::vjp(y.middleCols(b, e - b), g.middleCols(b, e - b), frequencies);
    });
}

} // namespace rye
