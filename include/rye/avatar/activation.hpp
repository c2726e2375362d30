// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/activation.hpp: from the face's raw attributes, and the steps that networks add to
/// them, to those of Gaussians, with vjp. Steps are 8 x N: log-scale, quaternion, logit opacity.
/// Source: GHA, generate(): exp(s + d), q + d, sigmoid(o + d); tanh of the feature.
#pragma once

#include <cmath>

#include <rye/backend/backend.hpp>
#include <rye/gaussian/attributes.hpp>
#include <rye/gaussian/gaussians.hpp>
#include <rye/math/scalar.hpp>
#include <rye/nn/elementwise.hpp>

namespace rye {

namespace detail {

/// tanh, element by element.
template <class T, Backend B>
void tanh_into(const B& backend, const Columns<T>& x, Columns<T>& y) {
    y.resize(x.rows(), x.cols());
    for_chunks(backend.threads, x.size(), 8192, [&](Index b, Index e, Index) {
        transform_array<B>(
            e - b, y.data() + b,
            [](const auto& v) {
                using std::tanh;
                return tanh(v);
            },
            x.data() + b);
    });
}

} // namespace detail

/// A face's attributes as they are trained: unbounded.
template <class T>
struct RawAttributes {
    const Columns<T>& log_scale;      ///< 3 x N
    const Columns<T>& rotation;       ///< 4 x N
    const Columns<T>& opacity_logit;  ///< 1 x N
};

namespace detail {

/// Destination of activated attributes: the first N columns, or more, of each.
template <class T>
struct DrawnAttributes {
    Columns<T>& scale;
    Columns<T>& rotation;
    Columns<T>& opacity;
};

/// Sets scale, rotation and opacity of Gaussian i. Without steps, give none.
template <class T, class... Steps>
    requires (sizeof...(Steps) <= 1)
void activate_point(const RawAttributes<T>& raw, Index i, const DrawnAttributes<T>& to,
                    const Steps&... steps) {
    for (Index k = 0; k < 3; ++k)
        to.scale(k, i) = drawn_scale(T((raw.log_scale(k, i) + ... + steps(k, i))));
    for (Index k = 0; k < 4; ++k) to.rotation(k, i) = (raw.rotation(k, i) + ... + steps(3 + k, i));
    to.opacity(0, i) = drawn_opacity(T((raw.opacity_logit(0, i) + ... + steps(7, i))));
}

/// ... of all N.
template <class T, Backend B, class... Steps>
    requires (sizeof...(Steps) <= 1)
void activate_into(const B& backend, const RawAttributes<T>& raw, const DrawnAttributes<T>& to,
                   const Steps&... steps) {
    for_chunks(backend.threads, raw.log_scale.cols(), 256, [&](Index b, Index e, Index) {
        for (Index i = b; i < e; ++i) activate_point(raw, i, to, steps...);
    });
}

} // namespace detail

/// The cotangents of raw attributes and steps alike, 8 x N, from those of the first N Gaussians of
/// `g`. The drawn ones are results of activate_into.
template <class T, Backend B>
Columns<T> activate_vjp(const B& backend, const Columns<T>& drawn_scale,
                        const Columns<T>& drawn_opacity, Index n, const Gaussians<T>& g) {
    Columns<T> r(8, n);
    for_chunks(backend.threads, n, 256, [&](Index b, Index e, Index) {
        for (Index i = b; i < e; ++i) {
            for (Index k = 0; k < 3; ++k)
                r(k, i) = detail::drawn_scale_vjp<T>(drawn_scale(k, i), g.scale(k, i));
            for (Index k = 0; k < 4; ++k) r(3 + k, i) = g.rotation(k, i);
            const T a = drawn_opacity(0, i);
            r(7, i) = detail::drawn_opacity_vjp<T>(a, T(1) - a, g.opacity(0, i));
        }
    });
    return r;
}

} // namespace rye
