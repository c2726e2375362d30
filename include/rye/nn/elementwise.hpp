// SPDX-License-Identifier: Apache-2.0
/// rye/nn/elementwise.hpp: element-wise formulas over flat arrays, in SIMD lanes where the backend
/// has them, with a scalar loop for the remainder.
#pragma once

#include <type_traits>

#include <rye/core/eigen.hpp>

#include <rye/autodiff/widen.hpp>
#include <rye/backend/backend.hpp>
#include <rye/core/concepts.hpp>
#include <rye/math/scalar.hpp>
#include <rye/nn/activations.hpp>

namespace rye {

/// Loads and stores a V: a number, or a vector.
template <class V, class T>
V load_as(const T* from) {
    if constexpr (std::is_same_v<V, T>)
        return *from;
    else
        return V::load_unaligned(from);
}

namespace detail {

/// Stores a number, or a vector.
template <class V, class T>
void store_as(const V& v, T* to) {
    if constexpr (std::is_same_v<V, T>)
        *to = v;
    else
        v.store_unaligned(to);
}

} // namespace detail

/// Loads a V, deduced from an argument.
template <class V, class T>
V load_like(const V&, const T* from) {
    return load_as<V>(from);
}

/// Calls f(std::type_identity<V>(), i) for i in [begin, end): V is the backend's vector, with i
/// advancing by its size, while whole vectors are left; then the scalar.
template <Backend B, class T, class F>
void each_vector(Index begin, Index end, const F& f) {
    Index i = begin;
    if constexpr (LaneBackend<B, T>) {
        using V = typename B::template batch<T>;
        constexpr Index lanes = static_cast<Index>(V::size);
        for (; i + lanes <= end; i += lanes) f(std::type_identity<V>(), i);
    }
    for (; i < end; ++i) f(std::type_identity<T>(), i);
}

namespace detail {

/// out[i] = f(in[i]...) for i in [0, n); out may be one of the inputs.
template <Backend B, class T, class F, class... In>
void transform_array(Index n, T* out, const F& f, const In*... in) {
    each_vector<B, T>(0, n, [&]<class V>(std::type_identity<V>, Index i) {
        store_as<V>(f(load_as<V>(in + i)...), out + i);
    });
}

} // namespace detail

/// The sum of n numbers as a W, in eight independent accumulators to hide the latency of additions.
template <class W, class T>
W sum_array(const T* x, Index n) {
    constexpr Index parts = 8;
    W sum[parts] = {W(0), W(0), W(0), W(0), W(0), W(0), W(0), W(0)};
    Index i = 0;
    for (; i + parts <= n; i += parts)
        for (Index k = 0; k < parts; ++k) sum[k] += detail::scalar_cast<W>(x[i + k]);
    for (; i < n; ++i) sum[0] += detail::scalar_cast<W>(x[i]);
    return ((sum[0] + sum[1]) + (sum[2] + sum[3])) + ((sum[4] + sum[5]) + (sum[6] + sum[7]));
}

} // namespace rye
