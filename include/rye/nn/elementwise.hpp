// SPDX-License-Identifier: Apache-2.0
/// rye/nn/elementwise.hpp: one formula over flat arrays, in lanes where the backend has them.
/// The remainder of an array runs the same formula on its scalar.
#pragma once

#include <type_traits>

#include <Eigen/Core>

#include <rye/backend/backend.hpp>
#include <rye/core/concepts.hpp>
#include <rye/math/scalar.hpp>

namespace rye {

/// The backend brings vectors of this scalar.
template <class B, class T>
concept HasLanes = Backend<B> && Real<T> && requires {
    typename B::template batch<T>;
};

/// Numbers at `from` of the kind of `like`: one, or a vector.
template <class V, class T>
V load_like(const V&, const T* from) {
    if constexpr (std::is_same_v<V, T>)
        return *from;
    else
        return V::load_unaligned(from);
}

/// out[i] = f(in[i]...) for i in [0, n); out may be one of the inputs.
template <Backend B, class T, class F, class... In>
void transform_array(Index n, T* out, const F& f, const In*... in) {
    Index i = 0;
    if constexpr (HasLanes<B, T>) {
        using V = typename B::template batch<T>;
        constexpr Index lanes = static_cast<Index>(V::size);
        for (; i + lanes <= n; i += lanes) f(V::load_unaligned(in + i)...).store_unaligned(out + i);
    }
    for (; i < n; ++i) out[i] = f(in[i]...);
}

/// A negative input keeps this share of itself.
inline constexpr double leaky_slope = 0.01;

/// x for x > 0, else 0.01 x. A NaN stays a NaN.
template <class T>
T leaky_relu(const T& x) {
    return select(x > T(0), x, T(T(real_t<T>(leaky_slope)) * x));
}

/// The cotangent of the input from the *output* y, whose sign is that of the input.
template <class T>
T leaky_relu_vjp(const T& y, const T& g) {
    return select(y > T(0), g, T(T(real_t<T>(leaky_slope)) * g));
}

/// x for x > 0, else 0. A NaN stays a NaN, unlike with max(0, x), so that it can be found.
template <class T>
T relu(const T& x) {
    return select(x <= T(0), T(0), x);
}

template <class T>
T relu_vjp(const T& y, const T& g) {
    return select(y > T(0), g, T(0));
}

} // namespace rye
