// SPDX-License-Identifier: Apache-2.0
/// rye/backend/bf16.hpp: numbers rounded to bfloat16 (8 bits of significand, the exponents of
/// float), of which processors with AVX512_BF16 multiply two a lane and add them to a float. Where
/// that is missing the same numbers are multiplied as floats: the error is there, not the speed.
#pragma once

#include <cstddef>
#include <cstdint>
#include <type_traits>

#include <rye/backend/lanes.hpp>
#include <rye/core/bit_cast.hpp>

namespace rye {

/// Two neighbours of a sum's depth, the first in the low half.
struct Bf16Pair {
    std::uint32_t bits;

    /// Each rounded to the nearest, ties to even; a NaN stays one.
    static Bf16Pair of(float first, float second) {
        return {rounded(first) >> 16U | (rounded(second) & 0xffff0000U)};
    }
    float first() const { return bit_cast<float>(bits << 16U); }
    float second() const { return bit_cast<float>(bits & 0xffff0000U); }

  private:
    static std::uint32_t rounded(float x) {
        const auto u = bit_cast<std::uint32_t>(x);
        return x == x ? u + 0x7fffU + (u >> 16U & 1U) : u | 0x400000U;
    }
};

/// A vector of pairs: what a register tile multiplies (see rye/nn/lanes/register_tile.hpp). Whether
/// by the processor's instruction is in the type, as the instruction set is.
template <class Batch, bool Instruction>
struct Bf16Pairs {
    using value_type = Bf16Pair;
    using sum_type = Batch;
    static constexpr std::size_t size = Batch::size;
    Batch first, second;

    explicit Bf16Pairs(Bf16Pair x) : first(x.first()), second(x.second()) {}
    static Bf16Pairs load_unaligned(const Bf16Pair* p) {
        alignas(64) float low[size], high[size];
        for (std::size_t i = 0; i < size; ++i) low[i] = p[i].first(), high[i] = p[i].second();
        return {Batch::load_aligned(low), Batch::load_aligned(high)};
    }
    /// sum + a b: the products are exact, each addition is rounded.
    friend Batch fma(const Bf16Pairs& a, const Bf16Pairs& b, const Batch& sum) {
        return fma(a.first, b.first, fma(a.second, b.second, sum));
    }

  private:
    Bf16Pairs(const Batch& low, const Batch& high) : first(low), second(high) {}
};

/// Whether this unit is compiled for processors with the instruction.
#if defined(__AVX512BF16__)
using Bf16Instruction = std::true_type;

/// The instruction takes denormals for zero.
template <class Arch>
    requires(xsimd::batch<float, Arch>::size == 16)
struct Bf16Pairs<xsimd::batch<float, Arch>, true> {
    using value_type = Bf16Pair;
    using sum_type = xsimd::batch<float, Arch>;
    static constexpr std::size_t size = 16;
    __m512i pairs;

    explicit Bf16Pairs(Bf16Pair x) : pairs(_mm512_set1_epi32(static_cast<int>(x.bits))) {}
    static Bf16Pairs load_unaligned(const Bf16Pair* p) { return Bf16Pairs(_mm512_loadu_si512(p)); }
    friend sum_type fma(const Bf16Pairs& a, const Bf16Pairs& b, const sum_type& sum) {
        return _mm512_dpbf16_ps(sum, reinterpret_cast<__m512bh>(a.pairs),
                                reinterpret_cast<__m512bh>(b.pairs));
    }

  private:
    explicit Bf16Pairs(__m512i x) : pairs(x) {}
};
#else
using Bf16Instruction = std::false_type;
#endif

} // namespace rye
