// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/nearest.hpp: a tile's list near to far, a part at a time: a block takes the
/// nearest keys that fit its shared memory and sorts them, and takes more only while a pixel is
/// open. Keys are unique, so the order does not depend on how they lay.
/// Source: Batcher, "Sorting Networks and Their Applications", 1968.
#pragma once

#include <cstdint>

#include <rye/splat/cuda/records.hpp>

namespace rye::detail {

/// The nearest keys of a tile's list that are not taken yet, sorted, in shared memory.
struct NearestKeys {
    static constexpr std::uint32_t most = 1024;

    std::uint64_t key[most];
    std::uint32_t bucket[128];
    std::uint32_t count, pick, picked;
    std::uint32_t most_depth, least_depth; ///< of the least, the complement
};

/// Walk over the n keys of one tile in parts. Every thread of the block holds the same values.
template <class Block>
struct NearestFirst {
    static constexpr int threads = Block::threads;
    static constexpr std::uint32_t most = NearestKeys::most;
    static_assert(threads == 128, "a bucket a thread");

    NearestKeys& shared;
    const std::uint64_t* keys;
    std::uint32_t n, taken = 0;
    std::uint64_t from = 0, last = 0; ///< range [from, last] of the keys left in a long list

    RYE_DEVICE NearestFirst(NearestKeys& s, const std::uint64_t* all, std::uint32_t count)
        : shared(s),
          keys(all),
          n(count) {}

    /// Sorts the next part into shared.key; returns how many keys, 0 at the end.
    RYE_DEVICE std::uint32_t next(Block& block) {
        if (taken >= n) return 0;
        const bool whole = n <= most;
        const std::uint32_t count = whole ? n : choose(block);
        taken += count;
        sort(block, whole ? keys : shared.key, count);
        return count;
    }

  private:
    /// Chooses the nearest buckets that hold no more than fit. A bucket that alone holds more is
    /// split by its next bits; as keys are unique, that ends.
    RYE_DEVICE std::uint32_t choose(Block& block) {
        if (taken == 0) {
            block.each_thread([&](int t) {
                if (t == 0) shared.most_depth = shared.least_depth = 0;
            });
            block.each_thread([&](int t) {
                std::uint32_t far = 0, near = 0;
                for (std::uint32_t k = static_cast<std::uint32_t>(t); k < n; k += threads) {
                    const auto depth = static_cast<std::uint32_t>(keys[k] >> 32U);
                    far = rye::max(far, depth);
                    near = rye::max(near, ~depth);
                }
                block.raise(&shared.most_depth, far);
                block.raise(&shared.least_depth, near);
            });
            from = std::uint64_t(~block.agree(shared.least_depth)) << 32U;
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

    /// Keys of a lane, K of them: number ((32 warp + lane) K + k) in the end.
    template <class W, int K>
    struct LaneKeys {
        typename W::U64 key[std::size_t(K)];
    };

    RYE_DEVICE void sort(Block& block, const std::uint64_t* source, std::uint32_t count) {
        if (count <= 128)
            sort<1>(block, source, count);
        else if (count <= 256)
            sort<2>(block, source, count);
        else if (count <= 512)
            sort<4>(block, source, count);
        else
            sort<8>(block, source, count);
    }

    /// Sorts bitonically in registers: over distances within a lane, between lanes, and, in only
    /// three steps, between warps through shared memory.
    template <int K>
    RYE_DEVICE void sort(Block& block, const std::uint64_t* source, std::uint32_t count) {
        using W = typename Block::Warp;
        using U = typename W::U;
        auto own = block.template of_warps<LaneKeys<W, K>>();
        block.each_warp([&](int w) {
            auto& key = own[w].key;
            const U at = U(static_cast<std::uint32_t>(32 * w)) + W::lane();
            repeated<K>([&](auto k) {
                const U i = at + U(128 * k);
                key[k] = W::read64_where(i < U(count), source, i, ~std::uint64_t(0));
            });
            within_lane<W, K>(key);
            for (std::uint32_t run = 2 * K; run <= 32 * K; run *= 2)
                within_warp<W, K>(key, w, run, run / 2);
        });
        for (std::uint32_t run = 64 * K; run <= 128 * K; run *= 2)
            for (std::uint32_t apart = run / 2; apart >= 32 * K; apart /= 2) {
                const auto place = [&](int w, int k) {
                    return U(static_cast<std::uint32_t>(128 * k + 32 * w)) + W::lane();
                };
                block.each_warp([&](int w) {
                    repeated<K>([&](auto k) { W::write(shared.key, place(w, k), own[w].key[k]); });
                });
                block.each_warp([&](int w) {
                    const int warps = static_cast<int>(apart / (32 * K));
                    const bool up = (static_cast<std::uint32_t>(32 * K * w) & run) == 0;
                    repeated<K>([&](auto k) {
                        const auto other =
                            W::read64_where(W::lane() < U(32), shared.key, place(w ^ warps, k), 0);
                        keep<W>(own[w].key[k], other, typename W::M(((w & warps) == 0) == up));
                    });
                    if (apart == 32 * K) within_warp<W, K>(own[w].key, w, run, 16 * K);
                });
            }
        block.each_warp([&](int w) {
            repeated<K>([&](auto k) {
                W::write(shared.key,
                         (U(static_cast<std::uint32_t>(32 * w)) + W::lane()) * U(K) + U(k),
                         own[w].key[k]);
            });
        });
    }

    template <class W>
    RYE_DEVICE static void keep(typename W::U64& key, const typename W::U64& other,
                                const typename W::M& least) {
        key = select((key < other) == least, key, other);
    }

    /// Sorts runs of up to K keys in each lane; the last runs ascend and descend by turns.
    template <class W, int K>
    RYE_DEVICE static void within_lane(typename W::U64 (&key)[std::size_t(K)]) {
        expanded<log2_of(K)>([&](auto level) {
            constexpr int run = 2 << level;
            expanded<level + 1>([&](auto step) {
                constexpr int apart = run >> (step + 1);
                expanded<K>([&](auto k) {
                    if constexpr ((k & apart) == 0) {
                        if constexpr (run < K)
                            order<W>(key[k], key[k + apart], typename W::M((k & run) == 0));
                        else
                            order<W>(key[k], key[k + apart],
                                     (W::lane() & typename W::U(1)) == typename W::U(0));
                    }
                });
            });
        });
    }
    RYE_HD static constexpr int log2_of(int k) { return k <= 1 ? 0 : 1 + log2_of(k / 2); }

    template <class W>
    RYE_DEVICE static void order(typename W::U64& a, typename W::U64& b, const typename W::M& up) {
        const auto swap = (b < a) == up;
        const auto low = select(swap, b, a);
        b = select(swap, a, b);
        a = low;
    }

    /// Does the steps of a run at distances from `apart`, at most 16 K, down to 1.
    template <class W, int K>
    RYE_DEVICE static void within_warp(typename W::U64 (&key)[std::size_t(K)], int w,
                                       std::uint32_t run, std::uint32_t apart) {
        using U = typename W::U;
        const U thread = U(static_cast<std::uint32_t>(32 * w)) + W::lane();
        const auto up = ((thread * U(K)) & U(run)) == U(0);
        for (; apart >= static_cast<std::uint32_t>(K); apart /= 2) {
            const std::uint32_t lanes = apart / static_cast<std::uint32_t>(K);
            const auto least = ((W::lane() & U(lanes)) == U(0)) == up;
            repeated<K>([&](auto k) {
                keep<W>(key[k], W::across(key[k], static_cast<int>(lanes)), least);
            });
        }
        expanded<log2_of(K)>([&](auto step) {
            constexpr int near = K >> (step + 1);
            expanded<K>([&](auto k) {
                if constexpr ((k & near) == 0) order<W>(key[k], key[k + near], up);
            });
        });
    }
};

} // namespace rye::detail
