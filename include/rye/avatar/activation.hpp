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

/// Sets scale, rotation and opacity of Gaussian i of `g`. Without steps, give none.
template <class T, class... Steps>
    requires (sizeof...(Steps) <= 1)
void activate_point(const Columns<T>& log_scale, const Columns<T>& rotation,
                    const Columns<T>& opacity_logit, Index i, Gaussians<T>& g,
                    const Steps&... steps) {
    for (Index k = 0; k < 3; ++k)
        g.scale(k, i) = drawn_scale(T((log_scale(k, i) + ... + steps(k, i))));
    for (Index k = 0; k < 4; ++k) g.rotation(k, i) = (rotation(k, i) + ... + steps(3 + k, i));
    g.opacity(0, i) = drawn_opacity(T((opacity_logit(0, i) + ... + steps(7, i))));
}

/// ... of all of them.
template <class T, Backend B, class... Steps>
    requires (sizeof...(Steps) <= 1)
void activate_into(const B& backend, const Columns<T>& log_scale, const Columns<T>& rotation,
                   const Columns<T>& opacity_logit, Gaussians<T>& g, const Steps&... steps) {
    const Index n = log_scale.cols();
    g.scale.resize(3, n);
    g.rotation.resize(4, n);
    g.opacity.resize(1, n);
    for_chunks(backend.threads, n, 1024, [&](Index b, Index e, Index) {
        for (Index i = b; i < e; ++i)
            activate_point(log_scale, rotation, opacity_logit, i, g, steps...);
    });
}

/// The cotangents of raw attributes and steps alike, 8 x N, from those of the Gaussians. `driven`
/// is what activate_into gave.
template <class T, Backend B>
Columns<T> activate_vjp(const B& backend, const Gaussians<T>& driven, const Gaussians<T>& g) {
    const Index n = driven.scale.cols();
    Columns<T> r(8, n);
    for_chunks(backend.threads, n, 1024, [&](Index b, Index e, Index) {
        for (Index i = b; i < e; ++i) {
            for (Index k = 0; k < 3; ++k)
                r(k, i) = drawn_scale_vjp<T>(driven.scale(k, i), g.scale(k, i));
            for (Index k = 0; k < 4; ++k) r(3 + k, i) = g.rotation(k, i);
            const T a = driven.opacity(0, i);
            r(7, i) = drawn_opacity_vjp<T>(a, T(1) - a, g.opacity(0, i));
        }
    });
    return r;
}

} // namespace rye
