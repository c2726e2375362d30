// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/host_groups.hpp: what a warp of a group does (group_products.hpp), on the host:
/// a warp's part of a product at once, when it is asked for; a piece of a ring is copied by the
/// warp that takes it, and is NaN once that has given it back.
#pragma once

#include <bit>
#include <cstdint>
#include <cstring>

#include <rye/backend/cuda/ring_memory.hpp>
#include <rye/backend/cuda/unrolled.hpp>
#include <rye/backend/cuda/warp_lanes.hpp>

namespace rye::detail {

/// The functions of backend/cuda/group_products.hpp's DeviceGroups.
struct HostGroups {
    using F = Lanes<float>;
    using U = Lanes<std::uint32_t>;
    struct Operand {
        const unsigned char* at;
        int along, deep;
    };

    static Operand operand(const void* at, int along, int deep) {
        return {static_cast<const unsigned char*>(at), along, deep};
    }
    static Operand moved(const Operand& o, int bytes) { return {o.at + bytes, o.along, o.deep}; }
    static void begin_products() {}
    static void end_products() {}
    template <int newer = 0>
    static void wait_for_products() {}
    template <std::size_t count>
    static void settle(Array<F, count>&) {}

    template <int n, bool onto, bool transposed>
    static void product(Array<F, std::size_t(n / 2)>& d, const Array<U, 4>& a, const Operand& b) {
        float left[16][16];
        for (int row = 0; row < 16; ++row)
            for (int k = 0; k < 16; ++k) {
                const std::uint32_t pair =
                    a[std::size_t(k / 8 * 2 + row / 8)].x[row % 8 * 4 + k % 8 / 2];
                left[row][k] = whole(k % 2 == 0 ? pair & 0xFFFFU : pair >> 16U);
            }
        sums<n, transposed>(d, left, b, onto);
    }
    template <int n>
    static void product_transposed(Array<F, std::size_t(n / 2)>& d, const Operand& a,
                                   const Operand& b, int w) {
        float left[16][16];
        for (int row = 0; row < 16; ++row)
            for (int k = 0; k < 16; ++k) left[row][k] = element<true>(a, 16 * w + row, k);
        sums<n, true>(d, left, b, true);
    }
    static U positive(const U& pair) {
        return U::each([&](int l) {
            const std::uint32_t low = whole(pair.x[l] & 0xFFFFU) > 0.0F ? 0xFFFFU : 0U,
                                high = whole(pair.x[l] >> 16U) > 0.0F ? 0xFFFFU : 0U;
            return low | high << 16U;
        });
    }

    template <class Ring>
    static void set_ring(Ring&, int) {}
    template <class Ring, class F2>
    static void fill(Ring&, const RingPlace<Ring>&, const F2&) {}
    template <class Ring, class F2>
    static const unsigned char* take(Ring& ring, const RingPlace<Ring>& place, const F2& f) {
        unsigned char* const slot = &ring.slot[place.slot][0];
        std::memset(slot, 0xFF, std::size_t(Ring::bytes));
        f(place.piece, [&](int to, const void* from, int bytes) {
            std::memcpy(slot + to, from, static_cast<std::size_t>(bytes));
        });
        return slot;
    }
    /// What was given back is there no more.
    template <class Ring>
    static void give(Ring& ring, const RingPlace<Ring>& place) {
        std::memset(&ring.slot[place.slot][0], 0xFF, std::size_t(Ring::bytes));
    }

  private:
    static float whole(std::uint32_t half) { return std::bit_cast<float>(half << 16U); }
    /// Number k of row, or column, i.
    template <bool transposed>
    static float element(const Operand& o, int i, int k) {
        const int inside = transposed ? k % 8 * 16 + i % 8 * 2 : i % 8 * 16 + k % 8 * 2;
        std::uint16_t half;
        std::memcpy(&half, o.at + i / 8 * o.along + k / 8 * o.deep + inside, sizeof half);
        return whole(half);
    }
    template <int n, bool transposed>
    static void sums(Array<F, std::size_t(n / 2)>& d, const float (&left)[16][16], const Operand& b,
                     bool onto) {
        for (int column = 0; column < n; ++column) {
            float right[16];
            for (int k = 0; k < 16; ++k) right[k] = element<transposed>(b, column, k);
            for (int row = 0; row < 16; ++row) {
                float& to = d[std::size_t(column / 8 * 4 + row / 8 * 2 + column % 2)]
                                .x[row % 8 * 4 + column % 8 / 2];
                double sum = onto ? static_cast<double>(to) : 0.0;
                for (int k = 0; k < 16; ++k)
                    sum += static_cast<double>(left[row][k]) * static_cast<double>(right[k]);
                to = static_cast<float>(sum);
            }
        }
    }
};

} // namespace rye::detail
