// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/nearest.hpp: a tile's list near to far, a part at a time: a block counts keys by
/// buckets of depth, takes the nearest buckets that fit its shared memory, and puts them in order
/// as far as a pixel is open: a key finds its place by looking at the others of its bucket. Keys
/// are unique, so the order does not depend on how they lay.
/// Source: Batcher, "Sorting Networks and Their Applications", 1968, for crowded buckets.
#pragma once

#include <cstdint>

#include <rye/splat/cuda/records.hpp>

#ifndef RYE_PART
#define RYE_PART 256
#endif
namespace rye::detail {

/// The nearest keys of a tile's list that are not taken yet, by buckets, in shared memory.
struct NearestKeys {
    static constexpr std::uint32_t most = 1024;   ///< keys
    static constexpr std::uint32_t buckets = 1024;

    /// Keys [low, high] are counted by buckets, each of 2^shift numbers.
    struct Level {
        std::uint64_t low, high;
        std::uint64_t last;       ///< no key is above
        std::uint32_t shift;
        std::uint32_t bucket;     ///< first bucket whose keys have not been in shared memory
        std::uint32_t before;     ///< keys of buckets before those in shared memory
        std::uint32_t crowd;      ///< most keys of a bucket
        std::uint32_t held;       ///< keys in shared memory
        std::uint32_t ready;      ///< of them, those in parts so far
    };

    std::uint64_t key[most];
    /// edge[b + 1]: keys of nearer buckets than b; with b's own once these are in `key`. So bucket
    /// b is then [edge[b], edge[b + 1]), less `before`. The last is the number of all.
    std::uint32_t edge[buckets + 2];
    std::uint32_t sums[128];
    std::uint32_t near, far;   ///< of the list: complement of the least depth, the most
    std::uint32_t crowd, pick; ///< most keys of a bucket; the first bucket that no longer fits
    Level level;
};

/// Walk over the n keys of one tile in parts. Every thread of the block holds the same values.
template <class Block>
struct NearestFirst {
    static constexpr int threads = Block::threads;
    static constexpr std::uint32_t most = NearestKeys::most, buckets = NearestKeys::buckets;
    static constexpr int of_thread = int(buckets) / threads;
    static constexpr int bucket_bits = 10;
    static_assert(threads == 128 && buckets == 1U << bucket_bits);

    NearestKeys& shared;
    const std::uint64_t* keys;
    std::uint32_t n, taken = 0; ///< number of keys, and of those in parts so far
    std::uint32_t begin = 0;    ///< of the part, in shared.key

    RYE_DEVICE NearestFirst(NearestKeys& s, const std::uint64_t* all, std::uint32_t count)
        : shared(s),
          keys(all),
          n(count) {}

    /// Sorts the next part, and puts given(key) into shared.key from `begin` on; returns how many,
    /// 0 at the end.
    template <class Given>
    RYE_DEVICE std::uint32_t next(Block& block, const Given& given) {
        if (taken >= n) return 0;
        Level level = shared.level;
        if (taken == 0) start(block, level);
        if (taken == 0 || level.ready == level.held) fill(block, level);
        begin = level.ready;
        std::uint32_t end = level.held;
        if (level.crowd <= rank_most && begin == 0 && end > first_part + first_part / 2) {
            const std::uint64_t b = (shared.key[first_part - 1] - level.low) >> level.shift;
            end = shared.edge[b + 1] - level.before;
        }
        level.ready = end;
        if (level.crowd <= rank_most)
            rank(block, level, given);
        else
            sort_held(block, level, given);
        taken += end - begin;
        return end - begin;
    }

  private:
    using Level = NearestKeys::Level;
    /// Keys of a bucket up to which each looks at the others.
    static constexpr std::uint32_t rank_most = 64;
    /// Keys of the first part, about: most pixels need no more of a long list.
    static constexpr std::uint32_t first_part = RYE_PART;

    /// Calls f for this thread's keys, whose reads run together.
    template <class F>
    RYE_DEVICE void each_key(int t, const F& f) const {
        constexpr std::uint32_t at_once = 8;
        for (auto from = static_cast<std::uint32_t>(t); from < n; from += at_once * threads) {
            std::uint64_t key[at_once];
            repeated<at_once>([&](auto e) {
                const std::uint32_t k = from + e * static_cast<std::uint32_t>(threads);
                key[e] = k < n ? keys[k] : 0;
            });
            repeated<at_once>([&](auto e) {
                if (from + e * static_cast<std::uint32_t>(threads) < n) f(key[e]);
            });
        }
    }

    /// Finds the range of the depths, and counts by buckets.
    RYE_DEVICE void start(Block& block, Level& level) {
        block.each_thread([&](int t) {
            if (t == 0) shared.near = shared.far = 0;
        });
        block.each_thread([&](int t) {
            std::uint32_t near = 0, far = 0;
            each_key(t, [&](std::uint64_t key) {
                const auto depth = static_cast<std::uint32_t>(key >> 32U);
                near = rye::max(near, ~depth);
                far = rye::max(far, depth);
            });
            block.raise(&shared.near, near);
            block.raise(&shared.far, far);
        });
        level.low = std::uint64_t(~shared.near) << 32U;
        level.last = std::uint64_t(shared.far) << 32U | 0xFFFFFFFFU;
        count(block, level, level.last);
    }

    /// Counts the keys of [level.low, high] by buckets.
    RYE_DEVICE void count(Block& block, Level& level, std::uint64_t high) {
        const int bits = 64 - Block::leading_zeros(high - level.low);
        level.high = high;
        level.shift = static_cast<std::uint32_t>(rye::max(bits - bucket_bits, 0));
        level.bucket = 0;
        block.each_thread([&](int t) {
            for (auto b = static_cast<std::uint32_t>(t); b <= buckets; b += threads)
                shared.edge[b] = 0;
            if (t == 0) shared.crowd = 0, shared.pick = buckets;
        });
        block.each_thread([&](int t) {
            each_key(t, [&](std::uint64_t key) {
                const std::uint64_t above = key - level.low;
                if (above <= high - level.low)
                    block.add(shared.edge + 1 + (above >> level.shift), 1U);
            });
        });
        auto own = block.template of_threads<Array<std::uint32_t, std::size_t(of_thread)>>();
        block.each_thread([&](int t) {
            std::uint32_t sum = 0, crowd = 0;
            repeated<of_thread>([&](auto e) {
                own[t][e] = shared.edge[1 + t * of_thread + e];
                sum += own[t][e];
                crowd = rye::max(crowd, own[t][e]);
            });
            shared.sums[t] = sum;
            block.raise(&shared.crowd, crowd);
        });
        const std::uint32_t total = block.exclusive_sums(shared.sums);
        block.each_thread([&](int t) {
            std::uint32_t at = shared.sums[t];
            repeated<of_thread>([&](auto e) {
                shared.edge[1 + t * of_thread + e] = at;
                at += own[t][e];
            });
            if (t == 0) shared.edge[buckets + 1] = total;
        });
        level.crowd = shared.crowd;
    }

    /// Takes the nearest buckets that fit into shared memory.
    RYE_DEVICE void fill(Block& block, Level& level) {
        if (level.bucket == buckets) { // all of these are taken
            level.low = level.high + 1;
            count(block, level, level.last);
        }
        for (;;) {
            const std::uint32_t from = level.bucket, before = shared.edge[from + 1];
            block.each_thread([&](int t) {
                repeated<of_thread>([&](auto e) {
                    const auto b = static_cast<std::uint32_t>(t + e * threads);
                    if (b >= from && shared.edge[b + 1] - before <= most &&
                        shared.edge[b + 2] - before > most)
                        shared.pick = b;
                });
            });
            const std::uint32_t pick = shared.pick;
            const std::uint32_t held = block.agree(shared.edge[pick + 1]) - before;
            if (held > 0) {
                gather(block, level, before, pick);
                level.bucket = pick;
                level.before = before;
                level.held = held;
                level.ready = 0;
                return;
            }
            // The bucket alone holds more than fit: it is split. As keys are unique, that ends.
            level.low += std::uint64_t(pick) << level.shift;
            count(block, level,
                  rye::min(level.last, level.low + ((std::uint64_t(1) << level.shift) - 1)));
        }
    }

    /// Copies the keys of buckets [level.bucket, end) to shared memory.
    RYE_DEVICE void gather(Block& block, const Level& level, std::uint32_t before,
                           std::uint32_t end) {
        const std::uint32_t from = level.bucket;
        block.each_thread([&](int t) {
            if (t == 0) shared.pick = buckets;
            each_key(t, [&](std::uint64_t key) {
                const std::uint64_t above = key - level.low;
                if (above > level.high - level.low) return;
                const auto b = static_cast<std::uint32_t>(above >> level.shift);
                if (b < from || b >= end) return;
                shared.key[block.add(shared.edge + 1 + b, 1U) - before] = key;
            });
        });
    }

    /// Puts the keys of a part in order.
    template <class Given>
    RYE_DEVICE void rank(Block& block, const Level& level, const Given& given) {
        constexpr int each = int(most) / threads;
        struct Own {
            std::uint64_t key[std::size_t(each)];
            std::uint32_t place[std::size_t(each)];
        };
        auto own = block.template of_threads<Own>();
        block.each_thread([&](int t) {
            repeated<each>([&](auto e) {
                const std::uint32_t k = begin + static_cast<std::uint32_t>(t + e * threads);
                own[t].place[e] = most;
                if (k >= level.ready) return;
                const std::uint64_t key = shared.key[k];
                const auto b = static_cast<std::uint32_t>((key - level.low) >> level.shift);
                own[t].key[e] = given(key);
                std::uint32_t place = shared.edge[b] - level.before;
                const std::uint32_t end = shared.edge[b + 1] - level.before;
                for (std::uint32_t j = place; j < end; ++j) place += shared.key[j] < key ? 1U : 0U;
                own[t].place[e] = place;
            });
        });
        block.each_thread([&](int t) {
            repeated<each>([&](auto e) {
                if (own[t].place[e] < most) shared.key[own[t].place[e]] = own[t].key[e];
            });
            if (t == 0) shared.level = level;
        });
    }

    /// Puts all keys in shared memory in order.
    template <class Given>
    RYE_DEVICE void sort_held(Block& block, const Level& level, const Given& given) {
        sort(block, shared.key, level.held);
        block.each_thread([&](int t) {
            for (auto k = static_cast<std::uint32_t>(t); k < level.held; k += threads)
                shared.key[k] = given(shared.key[k]);
            if (t == 0) shared.level = level;
        });
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
