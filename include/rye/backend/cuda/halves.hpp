// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/halves.hpp: floats kept as halves of IEEE 754 (binary16), two a word, and
/// products of matrices of them, laid out as those of planes.hpp. Rounding to the nearest is off by
/// at most 2^-11 of a number from 2^-14 to 65504, by 2^-25 below; larger ones become 65504.
/// Source: NVIDIA, "PTX ISA", 9.7 (cvt, mma).
#pragma once

#include <bit>
#include <cmath>
#include <cstdint>
#include <type_traits>

#include <rye/backend/cuda/unrolled.hpp>

namespace rye {

namespace detail {

/// Halves on the host.
struct HostHalves {
    static std::uint32_t half(float x) {
        const std::uint32_t sign = std::signbit(x) ? 0x8000U : 0U;
        const double size = std::abs(static_cast<double>(x));
        if (size != size) return 0x7FFFU;
        if (size >= 65504) return sign | 0x7BFFU;
        int exponent = 0;
        std::frexp(size, &exponent);
        // Numbers of this exponent are 2^step apart.
        const int step = (exponent > -13 ? exponent : -13) - 11;
        const double whole = std::nearbyint(std::ldexp(size, -step));
        return sign | static_cast<std::uint32_t>(whole + (step + 24) * 1024.0 * (size > 0));
    }
    static float whole(std::uint32_t half) {
        const int exponent = static_cast<int>(half >> 10U & 31U);
        const auto part = static_cast<double>(half & 1023U);
        const double size = exponent == 0 ? std::ldexp(part, -24)
                                          : std::ldexp(1024 + part, exponent - 25);
        return static_cast<float>((half & 0x8000U) != 0 ? -size : size);
    }
};

/// True for the warps of a device, whose lanes hold a number each.
template <class W>
inline constexpr bool lane_is_number = std::is_same_v<typename W::F, float>;

} // namespace detail

/// Returns two numbers as halves, a in the low one.
RYE_HD inline std::uint32_t halves_of(float a, float b) {
#if defined(__CUDA_ARCH__)
    std::uint32_t r;
#if __CUDA_ARCH__ >= 800
    asm("cvt.rn.satfinite.f16x2.f32 %0, %1, %2;" : "=r"(r) : "f"(b), "f"(a));
#else
    const float low = fminf(fmaxf(a, -65504.0F), 65504.0F),
                high = fminf(fmaxf(b, -65504.0F), 65504.0F);
    asm("{ .reg .f16 l, h; cvt.rn.f16.f32 l, %1; cvt.rn.f16.f32 h, %2; mov.b32 %0, {l, h}; }"
        : "=r"(r)
        : "f"(low), "f"(high));
#endif
    return r;
#else
    return detail::HostHalves::half(a) | detail::HostHalves::half(b) << 16U;
#endif
}
/// The same of each lane's numbers.
template <class W>
RYE_DEVICE typename W::U pack_halves(const typename W::F& a, const typename W::F& b) {
    if constexpr (detail::lane_is_number<W>)
        return halves_of(a, b);
    else
        return W::U::each([&](int l) { return halves_of(a.x[l], b.x[l]); });
}
/// d += a b, of 16 x 16 and 16 x 8 halves.
template <class W>
RYE_DEVICE void multiply_halves(Array<typename W::F, 4>& d, const Array<typename W::U, 4>& a,
                                const Array<typename W::U, 2>& b) {
    if constexpr (detail::lane_is_number<W>) {
#if defined(__CUDACC__)
#if !defined(__CUDA_ARCH__) || __CUDA_ARCH__ >= 800
        asm("mma.sync.aligned.m16n8k16.row.col.f32.f16.f16.f32 "
            "{%0, %1, %2, %3}, {%4, %5, %6, %7}, {%8, %9}, {%0, %1, %2, %3};"
            : "+f"(d[0]), "+f"(d[1]), "+f"(d[2]), "+f"(d[3])
            : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b[0]), "r"(b[1]));
#else
        repeated<2>([&](auto k) {
            asm("mma.sync.aligned.m16n8k8.row.col.f32.f16.f16.f32 "
                "{%0, %1, %2, %3}, {%4, %5}, {%6}, {%0, %1, %2, %3};"
                : "+f"(d[0]), "+f"(d[1]), "+f"(d[2]), "+f"(d[3])
                : "r"(a[2 * k]), "r"(a[2 * k + 1]), "r"(b[k]));
        });
#endif
#endif
    } else {
        const auto at = [](const typename W::U& r, int lane, int k) {
            const std::uint32_t w = r.x[lane];
            return static_cast<double>(
                detail::HostHalves::whole(k % 2 == 0 ? w & 0xFFFFU : w >> 16U));
        };
        for (int l = 0; l < 32; ++l)
            for (int i = 0; i < 4; ++i) {
                const int row = l / 4 + i / 2 * 8, column = l % 4 * 2 + i % 2;
                auto sum = static_cast<double>(d[std::size_t(i)].x[l]);
                for (int k = 0; k < 16; ++k) {
                    const int word = k % 8 / 2;
                    sum += at(a[std::size_t(k / 8 * 2 + row / 8)], row % 8 * 4 + word, k) *
                           at(b[std::size_t(k) / 8], column * 4 + word, k);
                }
                d[std::size_t(i)].x[l] = static_cast<float>(sum);
            }
    }
}

} // namespace rye
