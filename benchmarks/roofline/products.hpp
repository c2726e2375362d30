// SPDX-License-Identifier: Apache-2.0
/// benchmarks/roofline/products.hpp: chains of fused products of vectors that no compiler merges,
/// and a chain of sums of integers: what a core's rates are measured by (rates.hpp).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <type_traits>
#include <utility>

#include <rye/backend/lanes.hpp>

#include "clock.hpp"

namespace rye::bench {

/// The vectors of rye's kernels.
using Floats = XsimdBackend<>::batch<float>;

/// A vector's type as an argument.
template <class V>
struct VectorKind {
    using type = V;
};

/// Calls f(VectorKind<V>()) for vectors of float and of double of each width that this unit is
/// compiled for: of x86 4, 8 and 16 floats, and half as many doubles.
template <class F>
void each_vector_kind(const F& f) {
    const auto both = [&]<class A>(A) {
        if constexpr (xsimd::types::has_simd_register<float, A>::value)
            f(VectorKind<xsimd::batch<float, A>>());
        if constexpr (xsimd::types::has_simd_register<double, A>::value)
            f(VectorKind<xsimd::batch<double, A>>());
    };
#if defined(__SSE2__)
    both(xsimd::sse2());
#if defined(__AVX__)
    both(xsimd::avx());
#endif
#if defined(__AVX512F__)
    both(xsimd::avx512f());
#endif
#else
    both(DefaultArch());
#endif
}

/// Products that do not wait for each other. A chain's next product waits for the last one's 3 to 5
/// cycles, or 6 to 8 of a product and a sum, and 2 to 4 units take one each a cycle, so 8 to 16
/// chains fill them; each chain has a register of its own, and two registers hold the factors.
#if defined(__AVX512VL__) || defined(__aarch64__)
inline constexpr int chains = 24;        // of 32 registers
#else
inline constexpr int chains = 14;        // of 16
#endif

/// True where this unit's instructions have a fused product.
#if defined(__FMA__) || defined(__AVX512F__) || defined(__aarch64__)
inline constexpr bool fuses = true;
#else
inline constexpr bool fuses = false;
#endif

namespace detail {

/// Registers' fused products; void, never called, of others.
void fused(...);
#if defined(__FMA__)
inline __m128 fused(__m128 a, __m128 x, __m128 y) { return _mm_fmadd_ps(a, x, y); }
inline __m128d fused(__m128d a, __m128d x, __m128d y) { return _mm_fmadd_pd(a, x, y); }
inline __m256 fused(__m256 a, __m256 x, __m256 y) { return _mm256_fmadd_ps(a, x, y); }
inline __m256d fused(__m256d a, __m256d x, __m256d y) { return _mm256_fmadd_pd(a, x, y); }
#endif
#if defined(__AVX512F__)
inline __m512 fused(__m512 a, __m512 x, __m512 y) { return _mm512_fmadd_ps(a, x, y); }
inline __m512d fused(__m512d a, __m512d x, __m512d y) { return _mm512_fmadd_pd(a, x, y); }
#endif

} // namespace detail

/// Returns a x + y by one instruction, where there is one: xsimd's fma() may be a product and a
/// sum, which g++ fuses and clang does not.
template <class V>
[[gnu::always_inline]] inline V fused(const V& a, const V& x, const V& y) {
    if constexpr (requires { V(detail::fused(a.data, x.data, y.data)); })
        return V(detail::fused(a.data, x.data, y.data));
    else
        return xsimd::fma(a, x, y);
}

/// The first values of N chains of products, a vector each, or the last ones.
template <class V, int N = chains>
struct ChainValues {
    using T = typename V::value_type;
    static constexpr std::size_t lanes = V::size;
    alignas(64) std::array<T, std::size_t(N) * lanes> value;

    /// Returns different numbers, from 0.5 on.
    static ChainValues different() {
        ChainValues r;
        for (std::size_t i = 0; i < r.value.size(); ++i)
            r.value[i] = T(0.5) + T(0x1p-9) * static_cast<T>(i);
        return r;
    }
};

/// Calls f(0) ... f(N - 1) with constants, so that arrays indexed by them stay in registers.
template <int N, class F>
[[gnu::always_inline]] inline void each_chain(const F& f) {
    [&]<std::size_t... I>(std::index_sequence<I...>) __attribute__((always_inline)) {
        (f(std::integral_constant<std::size_t, I>()), ...);
    }(std::make_index_sequence<std::size_t(N)>());
}

/// A product's factor and what is added to it: a = a x + y.
template <class T>
struct ChainStep {
    T x = T(0.999), y = T(1e-3);
};

/// Takes `rounds` products of each chain. The compiler must know neither where they begin nor that
/// they differ: it computes chains of equal values once. So it learns nothing from the caller, and
/// all ends are stored.
template <class V, int N>
[[gnu::noinline]] void run_chains(const ChainValues<V, N>* from,
                                  const ChainStep<typename V::value_type>* step, int rounds,
                                  ChainValues<V, N>* to) {
    opaque(from);
    opaque(step);
    std::array<V, std::size_t(N)> a;
    each_chain<N>([&](auto i) __attribute__((always_inline)) {
        a[i] = V::load_aligned(from->value.data() + i * V::size);
    });
    const V x(step->x), y(step->y);
    for (int round = 0; round < rounds; ++round)
        each_chain<N>([&](auto i) __attribute__((always_inline)) { a[i] = fused(a[i], x, y); });
    each_chain<N>([&](auto i) __attribute__((always_inline)) {
        a[i].store_aligned(to->value.data() + i * V::size);
    });
}

/// Runs N chains for their time alone.
template <class V = Floats, int N = chains>
void fused_products(int rounds) {
    const auto from = ChainValues<V, N>::different();
    const ChainStep<typename V::value_type> step;
    ChainValues<V, N> to;
    run_chains(&from, &step, rounds, &to);
    opaque(to);
}

/// Adds `sums` times, a multiple of 64, where each sum waits for the one before. The addend is in a
/// register: some processors add constants without a cycle.
[[gnu::noinline]] inline std::uint64_t dependent_sums(std::uint64_t x, std::uint64_t addend,
                                                      int sums) {
    for (int i = 0; i < sums; i += 64) {
#pragma GCC unroll 64
        for (int k = 0; k < 64; ++k) {
            x += addend;
            asm volatile("" : "+r"(x), "+r"(addend));
        }
    }
    return x;
}

} // namespace rye::bench
