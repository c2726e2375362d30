// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/ring_memory.hpp: slots of shared memory that one warp of a block fills, in
/// turn, by copies of many bytes at once, and others take and give back.
#pragma once

#include <cstddef>
#include <cstdint>

#include <rye/core/config.hpp>

namespace rye::detail {

/// Slots of so many bytes, with a barrier for those that are full and one for those given back.
template <int slots_, int bytes_>
struct RingMemory {
    static constexpr int slots = slots_, bytes = bytes_;
    static_assert(bytes % 128 == 0);
    alignas(16) unsigned char slot[std::size_t(slots)][std::size_t(bytes)];
    std::uint64_t full[std::size_t(slots)], empty[std::size_t(slots)];
};

/// A place in a ring, where piece `piece` of all passes.
template <class Ring>
struct RingPlace {
    int piece = 0, slot = 0;
    std::uint32_t round = 0; ///< of the slots, modulo 2

    RYE_HD void next() {
        ++piece;
        if (++slot < Ring::slots) return;
        slot = 0;
        round ^= 1U;
    }
};

} // namespace rye::detail
