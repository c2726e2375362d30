// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/products.hpp: sums over visits, pixels and channels as products of matrices of
/// bf16, each operand being a sum of N of them. Layouts follow from the lanes of walk.hpp: position
/// p of a group of 16 visits is visit 4 (p % 8 / 2) + p % 2 + (p < 8 ? 0 : 2), which is where lane
/// q's visits stand in an operand of m16n8k16.
#pragma once

#include <rye/splat/cuda/walk.hpp>

namespace rye {

/// The visit at each lane's position of a group: of lanes' position p = lane % 16.
template <class W>
RYE_DEVICE typename W::U visit_at(const typename W::U& p) {
    using U = typename W::U;
    return p % U(8) / U(2) * U(4) + p % U(2) + select(p < U(8), U(0), U(2));
}

/// N planes of an operand of R registers.
template <class W, int N, int R>
using Planes = Array<Array<typename W::U, R>, N>;

/// d += the product of two sums of planes, without the terms below the last plane's.
template <class W, int N>
RYE_DEVICE void multiply(Array<typename W::F, 4>& d, const Planes<W, N, 4>& a,
                         const Planes<W, N, 2>& b) {
    if constexpr (N < 3) {
        unrolled<N>([&](auto i) { unrolled<N - i>([&](auto k) { W::mma(d, a[i], b[k]); }); });
    } else {
        // Units of matrices cut their sums off: a long chain of them would drift.
        using F = typename W::F;
        Array<F, 4> part{{F(0.0F), F(0.0F), F(0.0F), F(0.0F)}};
        unrolled<N>([&](auto i) { unrolled<N - i>([&](auto k) { W::mma(part, a[i], b[k]); }); });
        unrolled<4>([&](auto k) { d[k] = d[k] + part[k]; });
    }
}

/// Register r of a left operand's planes: numbers a and b of each lane.
template <class W, int N>
RYE_DEVICE void split(Planes<W, N, 4>& to, int r, typename W::F a, typename W::F b) {
    unrolled<N>([&](auto p) {
        to[p][r] = W::pack(a, b);
        if constexpr (p + 1 < N) {
            a = a - W::low(to[p][r]);
            b = b - W::high(to[p][r]);
        }
    });
}

/// The features of a group's visits as the right operand of products over visits (K) for channels
/// (N): of 8 channels each.
template <class W, class Shared, int channels>
struct FeaturesOverVisits {
    static constexpr int N = Shared::N;
    Planes<W, N, 2> of[channels / 8];

    RYE_DEVICE FeaturesOverVisits(const Shared& from, int w, std::uint32_t g) {
        using U = typename W::U;
        // Tiles: positions 0-7 and 8-15 of channels 0-7, then of 8-15.
        const U position = W::lane() % U(16);
        const U entry = W::read(from.visit[w], U(16 * g) + visit_at<W>(position));
        const U offset = entry * U(2 * Shared::row) + W::lane() / U(16) * U(16);
        unrolled<N>([&](auto p) {
            unrolled<(channels + 15) / 16>([&](auto c) {
                const auto t = W::template tiles<true>(&from.plane[p][0][0], offset + U(32 * c));
                of[2 * c][p] = {{t[0], t[1]}};
                if constexpr (2 * c + 1 < channels / 8) of[2 * c + 1][p] = {{t[2], t[3]}};
            });
        });
    }
};

/// The same as the right operand of products over channels (K) for visits (N): of 8 positions each.
template <class W, class Shared>
struct FeaturesOverChannels {
    static constexpr int N = Shared::N;
    static constexpr int steps = Shared::Layout::padded / 16;
    Planes<W, N, 2> of[2][steps];

    RYE_DEVICE FeaturesOverChannels() {}
    /// Of a group; or, in all positions, of the entry that has the background's colour.
    RYE_DEVICE FeaturesOverChannels(const Shared& from, int w, std::uint32_t g) {
        using U = typename W::U;
        const U position = W::lane() % U(8) + W::lane() / U(16) * U(8);
        read(from, W::read(from.visit[w], U(16 * g) + visit_at<W>(position)));
    }
    RYE_DEVICE explicit FeaturesOverChannels(const Shared& from) {
        read(from, typename W::U(static_cast<std::uint32_t>(Shared::none)));
    }

  private:
    /// Tiles: channels 0-7 and 8-15 of positions 0-7, then of 8-15.
    RYE_DEVICE void read(const Shared& from, const typename W::U& entry) {
        using U = typename W::U;
        const U offset = entry * U(2 * Shared::row) + W::lane() / U(8) % U(2) * U(16);
        unrolled<N>([&](auto p) {
            unrolled<steps>([&](auto c) {
                const auto t = W::template tiles<false>(&from.plane[p][0][0], offset + U(32 * c));
                of[0][c][p] = {{t[0], t[1]}};
                of[1][c][p] = {{t[2], t[3]}};
            });
        });
    }
};

} // namespace rye
