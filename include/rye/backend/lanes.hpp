// SPDX-License-Identifier: Apache-2.0
/// rye/backend/lanes.hpp: SIMD lanes times threads. The only include of xsimd
/// (backend/xsimd.hpp), whose system headers leak macros; in rye only headers of folders named
/// lanes/ include this one.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <utility>

#include <rye/backend/xsimd.hpp>

#include <rye/backend/backend.hpp>
#include <rye/core/concepts.hpp>

#if XSIMD_VERSION_MAJOR < 8 || (XSIMD_VERSION_MAJOR == 8 && XSIMD_VERSION_MINOR < 1)
#error "rye: got an older xsimd, expected 8.1 or newer"
#endif

namespace rye {

/// The best instruction set that this unit is compiled for. Without optimisation, g++'s AVX512BW
/// blends are macros that reject xsimd's vectors; avx512dq has the same registers.
#if defined(__AVX512BW__) && defined(__GNUC__) && !defined(__clang__) && !defined(__OPTIMIZE__)
using DefaultArch = xsimd::avx512dq;
#else
using DefaultArch = xsimd::default_arch;
#endif

/// The instruction set is part of the type, so units built for different ones do not collide.
///     XsimdBackend{}, XsimdBackend{Serial{}}, XsimdBackend{OpenMp{4}}
/// Plain loops run for types without a vector in the instruction set, and on targets that xsimd
/// does not support (WebAssembly without SIMD).
template <class Arch = DefaultArch, Threads P = DefaultThreads>
struct XsimdBackend {
    [[no_unique_address]] P threads{};
    using arch = Arch;
    template <Real T>
        requires(xsimd::types::has_simd_register<T, Arch>::value)
    using batch = xsimd::batch<T, Arch>;
};
template <Threads P>
XsimdBackend(P) -> XsimdBackend<DefaultArch, P>;
static_assert(Backend<XsimdBackend<>>);

/// Returns the same backend on the calling thread alone.
template <class Arch, Threads P>
XsimdBackend<Arch, Serial> one_thread(const XsimdBackend<Arch, P>&) {
    return {};
}

/// This unit's best vectors on the default threads.
template <Scalar T>
struct DefaultBackendOf<T> {
    using type = XsimdBackend<>;
};

namespace detail {

template <class T, class A>
struct RealOf<xsimd::batch<T, A>> {
    using type = T;
};

/// The vector of U with the register size of V: doubles beside floats.
template <class V, class U>
struct LanesLike;
template <class T, class A, class U>
struct LanesLike<xsimd::batch<T, A>, U> {
    using type = xsimd::batch<U, A>;
};

/// Batch of eight numbers; V itself if it has no more lanes than that, or where there is none.
template <class V>
struct EightLanes {
    using type = V;
};

} // namespace detail

#ifdef __AVX512F__  // the only vectors of more

namespace detail {

template <class T, class A>
    requires(xsimd::batch<T, A>::size > 8 &&
             !std::is_void_v<typename xsimd::make_sized_batch<T, 8>::type>)
struct EightLanes<xsimd::batch<T, A>> {
    using type = typename xsimd::make_sized_batch<T, 8>::type;
};

} // namespace detail

#endif

namespace detail {

/// True if a mask is a register with all bits of a true lane set: x86 before AVX-512, and wasm.
/// Decided by its type, as other masks can have the same size (NEON's are of integers).
template <class M>
inline constexpr bool wide_mask = false;
template <class T, class A>
inline constexpr bool wide_mask<xsimd::batch_bool<T, A>> =
    std::is_base_of_v<xsimd::types::simd_register<T, A>, xsimd::batch_bool<T, A>>;

/// True if a mask is an integer with one bit a lane: AVX-512. Only for masks that are not wide.
template <class M>
struct BitMask : std::false_type {};
template <class T, class A>
struct BitMask<xsimd::batch_bool<T, A>>
    : std::is_unsigned<typename xsimd::batch_bool<T, A>::register_type> {};

/// The sign bits of all lanes, where an instruction returns them; elsewhere void, never called.
void sign_bits(...);
#if defined(__SSE2__)
inline int sign_bits(__m128 x) { return _mm_movemask_ps(x); }
inline int sign_bits(__m128d x) { return _mm_movemask_pd(x); }
#endif
#if defined(__AVX__)
inline int sign_bits(__m256 x) { return _mm256_movemask_ps(x); }
inline int sign_bits(__m256d x) { return _mm256_movemask_pd(x); }
#endif

/// Prefetches the line of an address; does nothing where no instruction does, so that a compiler
/// leaves out what finds the address too. Always inlined: g++ takes a function that only prefetches
/// for one without effect, and drops the call.
#ifdef __wasm__
[[gnu::always_inline]] inline void prefetch(const void*) {}
[[gnu::always_inline]] inline void prefetch_to_write(const void*) {}
#else
[[gnu::always_inline]] inline void prefetch(const void* at) { __builtin_prefetch(at); }
[[gnu::always_inline]] inline void prefetch_to_write(const void* at) { __builtin_prefetch(at, 1); }
#endif

/// Returns four floats four times, where an instruction loads them so; else void, never called.
void load_four_times(...);
/// Keeps a vector in a register, though it could be loaded again; else never called.
void in_register(...);
#ifdef __AVX512F__
inline __m512 load_four_times(const float* x) { return _mm512_broadcast_f32x4(_mm_loadu_ps(x)); }
inline void in_register(__m512& x) { asm("" : "+v"(x)); }
#endif

/// True if sign_bits has an instruction for the mask M.
template <class M>
constexpr bool has_sign_bits() {
    if constexpr (wide_mask<M>)
        return std::is_same_v<decltype(sign_bits(std::declval<const M&>().data)), int>;
    else
        return false;
}

/// Returns a mask as bits, the first lane lowest. Where xsimd has no mask.mask(): the sign-bit
/// instruction, or one lane after another.
template <class M>
[[gnu::always_inline]] inline std::uint64_t lane_bits(const M& mask) {
    if constexpr (requires { mask.mask(); }) {
        return mask.mask();
    } else if constexpr (detail::has_sign_bits<M>()) {
        return static_cast<unsigned>(detail::sign_bits(mask.data));
    } else if constexpr (!detail::wide_mask<M> && detail::BitMask<M>::value) {
        return mask.data;
    } else {
        alignas(64) bool lane[M::size];
        mask.store_aligned(lane);
        std::uint64_t bits = 0;
        for (std::size_t i = 0; i < M::size; ++i)
            bits |= static_cast<std::uint64_t>(lane[i]) << i;
        return bits;
    }
}

} // namespace detail

/// Returns x where the mask is true, else 0: one instruction where a mask is a wide register.
template <class V>
[[gnu::always_inline]] inline V where(const typename V::batch_bool_type& mask, const V& x) {
    if constexpr (detail::wide_mask<typename V::batch_bool_type>)
        return V(mask.data) & x;
    else
        return select(mask, x, V(typename V::value_type(0)));
}

} // namespace rye
