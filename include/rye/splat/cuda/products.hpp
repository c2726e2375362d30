// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/products.hpp: sums over visits, pixels and channels as products of matrices of
/// bf16, each operand being a sum of N of them. Layouts follow from the lanes of walk.hpp: position
/// p of a group of 16 visits is visit 4 (p % 8 / 2) + p % 2 + (p < 8 ? 0 : 2), which is where lane
/// q's visits stand in an operand of m16n8k16.
#pragma once

#include <rye/backend/cuda/planes.hpp>
#include <rye/splat/cuda/walk.hpp>

namespace rye::detail {

/// Returns the visit at each lane's position of a group: of lanes' position p = lane % 16.
template <class W>
RYE_DEVICE typename W::U visit_at(const typename W::U& p) {
    using U = typename W::U;
    return p % U(8) / U(2) * U(4) + p % U(2) + select(p < U(8), U(0), U(2));
}

/// Reads features of a group's visits: x[i] of the lane's visit i, whose Gaussian is owner[i], or
/// none_of, and of the lane's channel among the eight.
template <class W>
RYE_DEVICE void read_features(typename W::F (&x)[4], const DeviceScene& scene,
                              const typename W::U (&owner)[4], int eight) {
    using U = typename W::U;
    const U channel = W::lane() / U(4) + U(static_cast<std::uint32_t>(8 * eight));
    const auto drawn = channel < U(static_cast<std::uint32_t>(scene.channels));
    const U stride(static_cast<std::uint32_t>(scene.feature.rows));
    const float* const from = scene.feature.data + scene.first_channel;
    repeated<4>([&](auto i) {
        x[i] =
            W::read_where(drawn && owner[i] < U(none_of), from, owner[i] * stride + channel, 0.0F);
    });
}

/// Returns the features of a group's visits as the right operand of products over visits (K) for
/// channels (N): 8 of them.
template <class W, int N>
RYE_DEVICE Planes<W, N, 2> features_over_visits(const DeviceScene& scene,
                                                const typename W::U (&owner)[4], int eight) {
    typename W::F x[4];
    read_features<W>(x, scene, owner, eight);
    Planes<W, N, 2> r;
    split<W, N>(r, 0, x[0], x[1]);
    split<W, N>(r, 1, x[2], x[3]);
    return r;
}

/// Returns the same as the right operand of products over channels (K), 16 of them, for visits (N).
/// Rows of numbers in shared memory; `row`: that of the visit at position lane / 4.
template <class W, int N>
RYE_DEVICE Planes<W, N, 2> features_over_channels(const float* rows, int stride,
                                                  const typename W::U& row, int sixteen) {
    using U = typename W::U;
    Planes<W, N, 2> r;
    repeated<2>([&](auto k) {
        const auto two = W::read2(rows, row * U(static_cast<std::uint32_t>(stride / 2)) +
                                            U(static_cast<std::uint32_t>(8 * sixteen + 4 * k)) +
                                            W::lane() % U(4));
        split<W, N>(r, k, two[0], two[1]);
    });
    return r;
}

} // namespace rye::detail
