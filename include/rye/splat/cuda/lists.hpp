// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/lists.hpp: from Gaussians to the entries of tiles, on a device: project and
/// count, scan, bin. Lists are those of TileLists, but the order within a tile's list is not yet
/// decided: the list is sorted when it is drawn, by unique keys.
#pragma once

#include <rye/splat/cuda/block_tiles.hpp>
#include <rye/splat/cuda/lens.hpp>

namespace rye::detail {

/// Sets words to 0: as a kernel, since the next one's blocks can wait for it in their places.
struct ClearKernel {
    static constexpr const char* name = "clear";
    static constexpr bool admits_next = true;
    static constexpr int threads = 128, blocks = 8;
    static constexpr std::uint32_t of_block = 4 * threads;
    struct Shared {};
    std::uint32_t* words;
    std::uint32_t count;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        const std::uint32_t from = static_cast<std::uint32_t>(block.index()) * of_block;
        block.each_thread([&](int t) {
            for (auto k = static_cast<std::uint32_t>(t); k < of_block; k += threads)
                if (from + k < count) words[from + k] = 0;
        });
    }
};

/// Projects Gaussians, and counts the entries of tiles.
template <class A, class D>
struct ProjectKernel {
    static constexpr const char* name = "project";
    static constexpr bool admits_next = true, waits_on_device = true;
    static constexpr int threads = 128, blocks = 8;
    /// Shared memory of a block.
    struct Shared {
        BlockTiles tiles;
        Footprint<float> footprint[threads]; ///< of those in many rows of tiles
        std::uint32_t count[threads]; ///< a Gaussian's tiles, then those of Gaussians before it
        std::uint32_t base;           ///< where the block's ranks are
        std::uint8_t finite[threads]; ///< 1 if all features of the Gaussian are finite
    };
    DeviceGaussians<const float> g;
    DeviceLens<D> lens;
    A accuracy;
    float cx, cy;
    int width, height;
    FrameMemory memory;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const auto base = static_cast<std::uint32_t>(block.index()) * threads;
        BlockTiles& tiles = shared.tiles;
        block.each_thread([&](int t) {
            if (t == 0) tiles.tall = 0;
            shared.finite[t] = 1;
        });
        if (accuracy.non_finite != NonFinite::trust)
            block.each_thread([&](int t) { look_at_features(shared, base, t); });
        block.each_thread([&](int t) {
            const std::uint32_t i = base + static_cast<std::uint32_t>(t);
            TileSpans& spans = tiles.spans[t];
            spans.first = spans.rows = 0;
            std::uint32_t places = 0;
            if (i < memory.count) {
                if (accuracy.non_finite != NonFinite::trust &&
                    !(shared.finite[t] != 0 && usable(i)))
                    block.add(&memory.report->non_finite, 1U);
                else
                    places = reach(i, spans, shared.footprint[t]);
                memory.spans[i] = spans;
                memory.places[i] = places;
                if (spans.rows > TileSpans::most) memory.footprint[i] = shared.footprint[t];
            }
            shared.count[t] = places;
            tiles.put(block, t, places);
        });
        const std::uint32_t total = block.exclusive_sums(shared.count);
        block.each_thread([&](int t) {
            if (t != 0) return;
            shared.base = block.add(&memory.report->ranked, total);
            memory.block_places[block.index()] = total;
            memory.block_ranks[block.index()] = shared.base;
        });
        tiles.template each<A::support>(
            block, shared.footprint, width, height,
            [&](const BlockTiles::Task& k) {
                return block.add(memory.counter(k.row, k.column), 1U);
            },
            [&](const BlockTiles::Task& k, std::uint32_t rank) {
                const std::uint32_t at = shared.base + shared.count[k.own] + k.rank;
                if (at < memory.entries) Block::write_once(memory.rank + at, rank);
            });
    }

  private:
    /// Tests the features of the block's Gaussians; neighbouring threads read neighbours.
    RYE_DEVICE void look_at_features(Shared& shared, std::uint32_t base, int t) const {
        const auto channels = static_cast<std::uint32_t>(g.channels());
        const std::uint32_t count =
            rye::min(memory.count - base, std::uint32_t(threads)) * channels;
        const float* const x = g.feature.data + Index(base) * g.channels();
        const auto look = [&](std::uint32_t k, float sum) {
            if (!(sum == 0.0F)) shared.finite[k / channels] = 0;
        };
        if (channels % 4 == 0 && reinterpret_cast<std::uintptr_t>(x) % 16 == 0) {
            const auto* const quads = reinterpret_cast<const Quad4*>(x);
            for (std::uint32_t k = static_cast<std::uint32_t>(t); k < count / 4; k += threads) {
                const Quad4 q = quads[k]; // a number that is not finite leaves a NaN
                look(4 * k, (q.x - q.x) + (q.y - q.y) + (q.z - q.z) + (q.w - q.w));
            }
        } else {
            for (std::uint32_t k = static_cast<std::uint32_t>(t); k < count; k += threads)
                look(k, x[k] - x[k]);
        }
    }

    RYE_DEVICE bool usable(std::uint32_t i) const {
        bool finite = true;
        const auto look = [&](const float* x, Index n) {
            for (Index k = 0; k < n; ++k) finite = finite && x[k] - x[k] == 0.0F;
        };
        look(g.mean.data + 3 * Index(i), 3);
        look(g.rotation.data + 4 * Index(i), 4);
        look(g.scale.data + 3 * Index(i), 3);
        look(g.opacity.data + i, 1);
        return finite;
    }

    /// Writes a Gaussian's record and, if it is visible, finds its rows of tiles; returns the
    /// number of tiles.
    RYE_DEVICE std::uint32_t reach(std::uint32_t i, TileSpans& spans,
                                   Footprint<float>& footprint) const {
        typename DeviceLens<D>::Held held;
        lens.put(held);
        const Projected<float, A::antialias> s =
            project<A::antialias>(shape_of(g, i), held.projector);
        const float opacity = g.opacity.data[i];
        if (!s.drawable || !(opacity > 0.0F)) return 0;
        const Splat<float> splat = make_splat(s, kept_opacity(s, opacity), accuracy);
        if (!(splat.log2_opacity > splat.cut)) return 0;
        const Cover<A::support, float> cover{footprint_of<A>(s, splat, cx, cy), width, height};
        const Span rows = cover.rows();
        if (!(rows.begin < rows.end && width > 0)) return 0;
        memory.record[i] = {{splat.x, splat.y, splat.ux, splat.vx},
                            {splat.vy, splat.log2_opacity, splat.depth, splat.floor}};
        const int first = rows.begin / tile_edge;
        const int last = (rows.end + tile_edge - 1) / tile_edge;
        spans.first = static_cast<std::uint16_t>(first);
        spans.rows = static_cast<std::uint16_t>(last - first);
        spans.key = depth_key(splat.depth);
        const bool tall = last - first > TileSpans::most;
        if (tall) footprint = cover.f;
        std::uint32_t places = 0;
        for (int y = first; y < last; ++y) {
            const Span x = cover.columns(y, rows);
            places += static_cast<std::uint32_t>(x.end - x.begin);
            if (tall) continue;
            spans.begin[y - first] = static_cast<std::uint16_t>(x.begin);
            spans.end[y - first] = static_cast<std::uint16_t>(x.end);
        }
        return places;
    }

  public:
    RYE_DEVICE static Shape<float> shape_of(const DeviceGaussians<const float>& g,
                                            std::uint32_t i) {
        const float* const m = g.mean.data + 3 * Index(i);
        const float* const q = g.rotation.data + 4 * Index(i);
        const float* const s = g.scale.data + 3 * Index(i);
        return {Vec3<float>(m[0], m[1], m[2]), Quat<float>(q[0], q[1], q[2], q[3]),
                Vec3<float>(s[0], s[1], s[2])};
    }
};

/// Computes the beginning of each tile's list, the number of places before each block's, and the
/// order in which tiles are drawn: by length, the longest first, so that no long list begins last.
struct ScanKernel {
    static constexpr const char* name = "scan of tiles";
    static constexpr bool admits_next = true, waits_on_device = true;
    static constexpr int threads = 1024, blocks = 1;
    static constexpr int each = 4; ///< numbers of a thread at a time
    /// Shared memory of a block.
    struct Shared {
        std::uint64_t wide[threads]; // a sum of 32 bits would hide too many entries
        std::uint32_t in_class[threads];                ///< tiles of each length, the longest first
        std::uint32_t number[each * threads + threads]; ///< some of those that are summed
    };
    FrameMemory memory;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        block.each_thread([&](int t) { shared.in_class[t] = 0; });
        const std::uint64_t total = sums(
            block, shared, memory.tiles,
            [&](std::uint32_t k) {
                const std::uint32_t here = *memory.counter(k);
                block.add(shared.in_class + class_of(here), 1U);
                return here;
            },
            memory.begin);
        const bool fits = total <= memory.entries;
        block.exclusive_sums(shared.in_class);
        block.each_thread([&](int t) {
            for (auto k = static_cast<std::uint32_t>(t); k < memory.tiles; k += threads)
                memory.order[block.add(shared.in_class + class_of(*memory.counter(k)), 1U)] = k;
            if (t != 0) return;
            memory.begin[memory.tiles] = static_cast<std::uint32_t>(total);
            memory.report->entries_low = static_cast<std::uint32_t>(total);
            memory.report->entries_high = static_cast<std::uint32_t>(total >> 32U);
            memory.report->overflow = fits ? 0U : 1U;
        });
        if (!fits)
            block.each_thread([&](int t) {
                for (auto k = static_cast<std::uint32_t>(t); k <= memory.tiles; k += threads)
                    memory.begin[k] = 0;
            });
        sums(
            block, shared, memory.blocks, [&](std::uint32_t k) { return memory.block_places[k]; },
            memory.block_places);
    }

  private:
    /// Writes the sum of the numbers before each of n to `to`, which may be where they are read;
    /// returns the sum of all. Neighbouring threads read and write neighbours.
    template <class Block, class Read>
    RYE_DEVICE static std::uint64_t sums(Block& block, Shared& shared, std::uint32_t n,
                                         const Read& read, std::uint32_t* to) {
        constexpr std::uint32_t some = each * threads;
        const auto at = [](std::uint32_t k) { return k + k / each; }; // in other banks
        std::uint64_t sum = 0;
        for (std::uint32_t from = 0; from < n; from += some) {
            block.each_thread([&](int t) {
                repeated<each>([&](auto e) {
                    const auto k = static_cast<std::uint32_t>(t + e * threads);
                    shared.number[at(k)] = from + k < n ? read(from + k) : 0U;
                });
            });
            block.each_thread([&](int t) {
                std::uint64_t own = 0;
                repeated<each>([&](auto e) {
                    own += shared.number[at(static_cast<std::uint32_t>(t * each + e))];
                });
                shared.wide[t] = own;
            });
            const std::uint64_t here = block.exclusive_sums(shared.wide);
            block.each_thread([&](int t) {
                auto before = static_cast<std::uint32_t>(sum + shared.wide[t]);
                repeated<each>([&](auto e) {
                    std::uint32_t& x = shared.number[at(static_cast<std::uint32_t>(t * each + e))];
                    const std::uint32_t own = x;
                    x = before;
                    before += own;
                });
            });
            block.each_thread([&](int t) {
                repeated<each>([&](auto e) {
                    const auto k = static_cast<std::uint32_t>(t + e * threads);
                    if (from + k < n) to[from + k] = shared.number[at(k)];
                });
            });
            sum += here;
        }
        return sum;
    }
    /// Returns the class of a list's length, one for every four entries.
    RYE_DEVICE static std::uint32_t class_of(std::uint32_t n) {
        return threads - 1 - rye::min(n / 4, std::uint32_t(threads - 1));
    }
};

/// Puts every entry into its tile's list, in any order.
template <class A>
struct BinKernel {
    static constexpr const char* name = "bin";
    static constexpr bool admits_next = true, waits_on_device = true;
    static constexpr int threads = 128, blocks = 8;
    /// Shared memory of a block.
    struct Shared {
        BlockTiles tiles;
        std::uint32_t before[threads]; ///< places of Gaussians before each
    };
    int width, height;
    FrameMemory memory;
    std::uint32_t passes; ///< the first is of Gaussians that begin in the first rows of tiles

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        if (memory.report->overflow != 0) return;
        const std::uint32_t pass = static_cast<std::uint32_t>(block.index()) / memory.blocks;
        const std::uint32_t number = static_cast<std::uint32_t>(block.index()) % memory.blocks;
        const std::uint32_t base = number * threads;
        const auto is_in_pass = [&](const TileSpans& s) {
            return passes == 1 || s.first * passes / (memory.tiles / memory.columns) == pass;
        };
        BlockTiles& tiles = shared.tiles;
        block.each_thread([&](int t) {
            if (t == 0) tiles.tall = 0;
        });
        block.each_thread([&](int t) {
            const std::uint32_t i = base + static_cast<std::uint32_t>(t);
            tiles.spans[t].first = tiles.spans[t].rows = 0;
            std::uint32_t places = 0;
            if (i < memory.count) {
                places = memory.places[i];
                tiles.spans[t] = memory.spans[i];
            }
            shared.before[t] = places;
            if (!is_in_pass(tiles.spans[t])) tiles.spans[t].rows = 0, places = 0;
            tiles.put(block, t, places);
        });
        const std::uint32_t total = block.exclusive_sums(shared.before);
        const std::uint32_t before = memory.block_places[number];
        const std::uint32_t ranks = memory.block_ranks[number];
        const bool kept = memory.groups > 0;
        if (kept && pass == 0)
            block.each_thread([&](int t) { // the words that begin with a place of the block
                for (std::uint32_t k = (before + 7) / 8 + static_cast<std::uint32_t>(t);
                     8 * k < before + total; k += threads)
                    memory.touched[k] = 0;
                if (passes == 1) return;
                for (auto k = static_cast<std::uint32_t>(t); k < total; k += threads)
                    Block::write_once(memory.owner + before + k,
                                      base + BlockTiles::search(shared.before, k));
            });
        tiles.template each<A::support>(
            block, memory.footprint + base, width, height,
            [&](const BlockTiles::Task& k) {
                return Array<std::uint32_t, 2>{
                    {memory.begin[memory.tile(k.row, k.column)],
                     Block::read_once(memory.rank + ranks + shared.before[k.own] + k.rank)}};
            },
            [&](const BlockTiles::Task& k, const Array<std::uint32_t, 2>& at) {
                const std::uint32_t owner = base + k.own;
                const std::uint32_t place = before + shared.before[k.own] + k.rank;
                memory.key[at[0] + at[1]] =
                    std::uint64_t(tiles.spans[k.own].key) << 32U | (kept ? place : owner);
                if (kept && passes == 1) Block::write_once(memory.owner + place, owner);
            });
    }
};

} // namespace rye::detail
