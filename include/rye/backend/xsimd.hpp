// SPDX-License-Identifier: Apache-2.0
/// rye/backend/xsimd.hpp: explicit lanes times threads. The only include of xsimd, whose system
/// headers leak macros; nothing else may include it but the kernels of this backend.
#pragma once

#include <cstddef>
#include <cstdint>

#include <xsimd/xsimd.hpp>

#include <rye/backend/backend.hpp>
#include <rye/core/concepts.hpp>

namespace rye {

/// The instruction set is a type, so units built for different ones do not collide.
template <class Arch = xsimd::default_arch, Threads P = DefaultThreads>
struct XsimdBackend {
    using threads = P;
    using arch = Arch;
    template <Real T>
    using batch = xsimd::batch<T, Arch>;
};
static_assert(Backend<XsimdBackend<>>);

template <class T, class A>
struct RealOf<xsimd::batch<T, A>> {
    using type = T;
};
template <class T, class A>
const xsimd::batch<T, A>& value_of(const xsimd::batch<T, A>& x) {
    return x;
}

namespace detail {

#if defined(__SSE2__)
inline int sign_bits(__m128 x) { return _mm_movemask_ps(x); }
inline int sign_bits(__m128d x) { return _mm_movemask_pd(x); }
#endif
#if defined(__AVX__)
inline int sign_bits(__m256 x) { return _mm256_movemask_ps(x); }
inline int sign_bits(__m256d x) { return _mm256_movemask_pd(x); }
#endif

} // namespace detail

/// A mask as bits, that of the first lane lowest. Versions of the library that do not say get the
/// instruction.
template <class M>
[[gnu::always_inline]] inline std::uint64_t lane_bits(const M& mask) {
    if constexpr (requires { mask.mask(); }) {
        return mask.mask();
    } else if constexpr (requires { mask.data % 2; }) {  // bits
        return mask.data;
    } else if constexpr (requires { detail::sign_bits(mask.data); }) {
        return static_cast<unsigned>(detail::sign_bits(mask.data));
    } else {
        alignas(64) bool lane[M::size];
        mask.store_aligned(lane);
        std::uint64_t bits = 0;
        for (std::size_t i = 0; i < M::size; ++i)
            bits |= static_cast<std::uint64_t>(lane[i]) << i;
        return bits;
    }
}

} // namespace rye
