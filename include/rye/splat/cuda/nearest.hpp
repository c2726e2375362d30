// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/nearest.hpp: a tile's list near to far, a part at a time: a block takes the
/// nearest keys that fit its shared memory and sorts them, and takes more only while a pixel is
/// open. Keys are unique, so the order does not depend on how they lay.
/// Source: Batcher, "Sorting Networks and Their Applications", 1968.
#pragma once

#include <cstdint>

#include <rye/splat/cuda/records.hpp>

namespace rye {

struct NearestKeys {
    static constexpr std::uint32_t most = 1024;

    std::uint64_t key[most];
    std::uint32_t bucket[128];
    std::uint32_t count, most_depth, pick, picked;
};

/// The keys of one tile, n from `keys`, in parts. Every thread of the block holds the same.
template <class Block>
struct NearestFirst {
    static constexpr int threads = Block::threads;
    static constexpr std::uint32_t most = NearestKeys::most;
    static_assert(threads == 128, "a bucket a thread");

    NearestKeys& shared;
    const std::uint64_t* keys;
    std::uint32_t n, taken = 0;
    std::uint64_t from = 0, last = 0;      ///< keys in [from, last] are left, of a long list

    RYE_DEVICE NearestFirst(NearestKeys& s, const std::uint64_t* all, std::uint32_t count)
        : shared(s), keys(all), n(count) {}

    /// Sorts the next part into shared.key; returns how many keys, 0 at the end.
    RYE_DEVICE std::uint32_t next(Block& block) {
        if (taken >= n) return 0;
        const std::uint32_t count = n <= most ? copy(block) : choose(block);
        taken += count;
        sort(block, count);
        return count;
    }

  private:
    RYE_DEVICE std::uint32_t copy(Block& block) {
        block.each_thread([&](int t) {
            for (std::uint32_t k = static_cast<std::uint32_t>(t); k < n; k += threads)
                shared.key[k] = keys[k];
        });
        return n;
    }

    /// The nearest buckets that hold no more than fit. A bucket that alone holds more is split by
    /// its next bits; as keys are unique, that ends.
    RYE_DEVICE std::uint32_t choose(Block& block) {
        if (taken == 0) {
            block.each_thread([&](int t) {
                if (t == 0) shared.most_depth = 0;
            });
            block.each_thread([&](int t) {
                std::uint32_t far = 0;
                for (std::uint32_t k = static_cast<std::uint32_t>(t); k < n; k += threads)
                    far = rye::max(far, static_cast<std::uint32_t>(keys[k] >> 32U));
                block.raise(&shared.most_depth, far);
            });
            last = std::uint64_t(block.agree(shared.most_depth)) << 32U | 0xFFFFFFFFU;
        }
        std::uint64_t low = from, high = last;
        for (;;) {
            const int bits = 64 - Block::leading_zeros(high - low);
            const int shift = bits > 7 ? bits - 7 : 0;
            block.each_thread([&](int t) {
                shared.bucket[t] = 0;
                if (t == 0) shared.pick = threads, shared.picked = 0;
            });
            block.each_thread([&](int t) {
                for (std::uint32_t k = static_cast<std::uint32_t>(t); k < n; k += threads) {
                    const std::uint64_t key = keys[k];
                    if (key >= low && key <= high)
                        block.add(shared.bucket + ((key - low) >> shift), 1U);
                }
            });
            auto own = block.template of_threads<std::uint32_t>();
            block.each_thread([&](int t) { own[t] = shared.bucket[t]; });
            const std::uint32_t total = block.exclusive_sums(shared.bucket);
            block.each_thread([&](int t) {
                const std::uint32_t before = shared.bucket[t];
                if (before <= most && before + own[t] > most) {
                    shared.pick = static_cast<std::uint32_t>(t);
                    shared.picked = before;
                }
            });
            const std::uint32_t pick = block.agree(shared.pick);
            const std::uint32_t picked = block.agree(shared.picked);
            if (pick == threads) return gather(block, low, high, total);
            const std::uint64_t start = low + (std::uint64_t(pick) << shift);
            if (picked > 0) return gather(block, low, start - 1, picked);
            low = start;
            high = rye::min(high, start + ((std::uint64_t(1) << shift) - 1));
        }
    }

    RYE_DEVICE std::uint32_t gather(Block& block, std::uint64_t low, std::uint64_t high,
                                    std::uint32_t count) {
        block.each_thread([&](int t) {
            if (t == 0) shared.count = 0;
        });
        block.each_thread([&](int t) {
            for (std::uint32_t k = static_cast<std::uint32_t>(t); k < n; k += threads) {
                const std::uint64_t key = keys[k];
                if (key >= low && key <= high) shared.key[block.add(&shared.count, 1U)] = key;
            }
        });
        from = high + 1;
        return count;
    }

    /// Bitonic. A warp's 32 pairs at a distance of up to 32 lie in 64 keys that no other touches.
    RYE_DEVICE void sort(Block& block, std::uint32_t count) {
        std::uint32_t size = 2;
        while (size < count) size *= 2;
        block.each_thread([&](int t) {
            for (std::uint32_t k = count + static_cast<std::uint32_t>(t); k < size; k += threads)
                shared.key[k] = ~std::uint64_t(0);
        });
        for (std::uint32_t run = 2; run <= size; run *= 2)
            for (std::uint32_t apart = run / 2; apart > 0; apart /= 2) {
                const auto exchange = [&](int t) {
                    for (std::uint32_t p = static_cast<std::uint32_t>(t); p < size / 2;
                         p += threads) {
                        const std::uint32_t low = p & (apart - 1);
                        const std::uint32_t i = (p - low) * 2 + low;
                        const std::uint64_t a = shared.key[i], b = shared.key[i + apart];
                        if ((a > b) == ((i & run) == 0)) {
                            shared.key[i] = b;
                            shared.key[i + apart] = a;
                        }
                    }
                };
                if (apart > 32 || (apart == 1 && run >= 64))
                    block.each_thread(exchange);
                else
                    block.each_lane(exchange);
            }
        block.each_thread([](int) {});
    }
};

} // namespace rye
