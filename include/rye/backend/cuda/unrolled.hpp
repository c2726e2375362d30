// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/unrolled.hpp: unrolled loops of a fixed length: arrays that they index stay in
/// registers whatever their size.
#pragma once

#include <utility>

#include <rye/core/array.hpp>

namespace rye {

/// A number as a type: std::integral_constant, whose conversion device code may not call.
template <int n>
struct Constant {
    static constexpr int value = n;
    RYE_HD constexpr operator int() const { return n; }
};

namespace detail {

#if defined(__CUDACC__)
template <class F, int... I>
__device__ __forceinline__ void unroll(F&& f, std::integer_sequence<int, I...>) {
    (f(Constant<I>{}), ...);
}
#else
/// Not unrolled on the host, which gains nothing and would compile for minutes.
template <class F, int... I>
[[gnu::noinline]] void unroll(F&& f, std::integer_sequence<int, I...>) {
    (f(Constant<I>{}), ...);
}
#endif

/// Calls f(0) ... f(n - 1), each with its number as a type.
template <int n, class F>
RYE_DEVICE inline void expanded(F&& f) {
    detail::unroll(f, std::make_integer_sequence<int, n>());
}

} // namespace detail

/// Calls f(0) ... f(n - 1). On a device as `expanded`; on the host a loop, so that f, whose
/// argument is then an int, is compiled once.
template <int n, class F>
RYE_DEVICE inline void repeated(F&& f) {
#if defined(__CUDACC__)
    detail::expanded<n>(f);
#else
    for (int i = 0; i < n; ++i) f(i);
#endif
}

namespace detail {

/// Four numbers that are read and written at once.
struct alignas(16) Quad4 {
    float x, y, z, w;
};

} // namespace detail

} // namespace rye
