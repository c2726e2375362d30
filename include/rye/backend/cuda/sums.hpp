// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/sums.hpp: sums of a block's threads, in one order whichever thread runs first.
#pragma once

#include <rye/core/config.hpp>

namespace rye::detail {

/// Adds the sums of a block's threads by halves; the result is in sum[0] afterwards.
template <class Block, class T>
RYE_DEVICE void add_up(Block& block, T* sum) {
    for (int apart = Block::threads / 2; apart > 0; apart /= 2)
        block.each_thread([&](int t) {
            if (t < apart) sum[t] += sum[t + apart];
        });
}

} // namespace rye::detail
