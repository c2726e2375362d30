// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/planes.hpp: products of matrices of 16 x 8 x 16 numbers by a warp, on units of
/// bf16, to the accuracy that N numbers of bf16 a float give: each operand is a sum of N planes,
/// whose relative errors are about 2.4e-3, 4.2e-6 and 6e-9 for N = 1, 2 and 3. Left operands have
/// 4 registers a lane, right ones 2, sums 4, laid out as those of mma.m16n8k16.
#pragma once

#include <rye/backend/cuda/unrolled.hpp>

namespace rye {

/// N planes of an operand of R registers.
template <class W, int N, int R>
using Planes = Array<Array<typename W::U, std::size_t(R)>, std::size_t(N)>;

/// d += the product of two sums of planes, without the terms below the last plane's.
template <class W, int N>
RYE_DEVICE void multiply(Array<typename W::F, 4>& d, const Planes<W, N, 4>& a,
                         const Planes<W, N, 2>& b) {
    if constexpr (N < 3) {
        detail::expanded<N>(
            [&](auto i) { repeated<N - i>([&](auto k) { W::mma(d, a[i], b[k]); }); });
    } else {
        // Units of matrices cut their sums off: a long chain of them would drift.
        using F = typename W::F;
        Array<F, 4> part{{F(0.0F), F(0.0F), F(0.0F), F(0.0F)}};
        detail::expanded<N>(
            [&](auto i) { repeated<N - i>([&](auto k) { W::mma(part, a[i], b[k]); }); });
        detail::expanded<4>([&](auto k) { d[k] = d[k] + part[k]; });
    }
}

/// Register r of a left operand's planes: numbers a and b of each lane.
template <class W, int N>
RYE_DEVICE void split(Planes<W, N, 4>& to, int r, typename W::F a, typename W::F b) {
    detail::expanded<N>([&](auto p) {
        to[p][r] = W::pack(a, b);
        if constexpr (p + 1 < N) {
            a = a - W::low(to[p][r]);
            b = b - W::high(to[p][r]);
        }
    });
}

/// Register r of a right operand's planes.
template <class W, int N>
RYE_DEVICE void split(Planes<W, N, 2>& to, int r, typename W::F a, typename W::F b) {
    detail::expanded<N>([&](auto p) {
        to[p][r] = W::pack(a, b);
        if constexpr (p + 1 < N) {
            a = a - W::low(to[p][r]);
            b = b - W::high(to[p][r]);
        }
    });
}

} // namespace rye
