// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/lists.hpp: from Gaussians to the entries of tiles, on a device: project and
/// count, scan, bin. Lists are those of TileLists, but the order within a tile's list is not yet
/// decided: the list is sorted when it is drawn, by unique keys.
#pragma once

#include <rye/splat/cuda/lens.hpp>
#include <rye/splat/cuda/records.hpp>

namespace rye::detail {

/// Calls f(row, begin, end) for each row of tiles that a Gaussian reaches.
template <Support support, class F>
RYE_DEVICE void each_span(const TileSpans& s, const Footprint<float>* footprint, int width,
                          int height, const F& f) {
    if (s.rows <= TileSpans::most) {
        for (int y = 0; y < s.rows; ++y) f(s.first + y, int(s.begin[y]), int(s.end[y]));
        return;
    }
    const Cover<support, float> cover{*footprint, width, height};
    const Span rows = cover.rows();
    for (int y = s.first; y < s.first + s.rows; ++y) {
        const Span x = cover.columns(y, rows);
        f(y, x.begin, x.end);
    }
}

/// The tiles of a block's Gaussians as one row of tasks, so that its threads share them evenly;
/// those of Gaussians in many rows of tiles are taken one Gaussian after the other.
struct BlockTiles {
    static constexpr int threads = 128;
    TileSpans spans[threads];
    std::uint32_t before[threads]; ///< tasks of Gaussians before each
    std::uint32_t tall;            ///< number of Gaussians in many rows
    std::uint32_t index[threads];  ///< those Gaussians

    /// Enters Gaussian t, whose spans are set, with its number of places.
    template <class Block>
    RYE_DEVICE void put(Block& block, int t, std::uint32_t places) {
        const bool is_tall = spans[t].rows > TileSpans::most;
        before[t] = is_tall ? 0U : places;
        if (is_tall) index[block.add(&tall, 1U)] = static_cast<std::uint32_t>(t);
    }

    /// Calls f(Gaussian, its tile's rank, row, column) for all tiles of the block.
    template <Support support, class Block, class F>
    RYE_DEVICE void each(Block& block, const Footprint<float>* footprints, int width, int height,
                         const F& f) {
        const std::uint32_t tasks = block.exclusive_sums(before);
        block.each_thread([&](int t) {
            for (std::uint32_t k = static_cast<std::uint32_t>(t); k < tasks; k += threads) {
                int low = 0; // the last Gaussian whose tasks begin at k or before
                for (int step = threads / 2; step > 0; step /= 2)
                    if (before[low + step] <= k) low += step;
                const TileSpans& s = spans[low];
                const std::uint32_t rank = k - before[low];
                int row = 0, rest = static_cast<int>(rank);
                for (int y = 0; y + 1 < TileSpans::most; ++y) {
                    const int wide = s.end[y] - s.begin[y];
                    if (row == y && y + 1 < s.rows && rest >= wide) rest -= wide, ++row;
                }
                f(low, rank, s.first + row, s.begin[row] + rest);
            }
        });
        for (std::uint32_t k = 0; k < tall; ++k)
            block.each_thread([&](int t) {
                const int own = static_cast<int>(index[k]);
                std::uint32_t rank = 0;
                each_span<support>(
                    spans[own], footprints + own, width, height, [&](int row, int begin, int end) {
                        for (int x = begin + t; x < end; x += threads)
                            f(own, rank + static_cast<std::uint32_t>(x - begin), row, x);
                        rank += static_cast<std::uint32_t>(end - begin);
                    });
            });
    }
};

/// Projects Gaussians, and counts the entries of tiles.
template <class A, class D>
struct ProjectKernel {
    static constexpr const char* name = "project";
    static constexpr int threads = 128, blocks = 8;
    /// Shared memory of a block.
    struct Shared {
        BlockTiles tiles;
        std::uint32_t places[threads];
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
        block.each_thread([&](int t) {
            if (t == 0) shared.tiles.tall = 0;
            shared.finite[t] = 1;
        });
        if (accuracy.non_finite != NonFinite::trust)
            block.each_thread([&](int t) { look_at_features(shared, base, t); });
        block.each_thread([&](int t) {
            const std::uint32_t i = base + static_cast<std::uint32_t>(t);
            TileSpans& spans = shared.tiles.spans[t];
            spans.first = spans.rows = 0;
            std::uint32_t places = 0;
            if (i < memory.count) {
                if (accuracy.non_finite != NonFinite::trust &&
                    !(shared.finite[t] != 0 && usable(i)))
                    block.add(&memory.report->non_finite, 1U);
                else
                    places = reach(i, spans);
                memory.spans[i] = spans;
                memory.places[i] = places;
            }
            shared.places[t] = places;
            shared.tiles.put(block, t, places);
        });
        shared.tiles.template each<A::support>(block, memory.footprint + base, width, height,
                                               [&](int, std::uint32_t, int row, int column) {
                                                   block.add(memory.counter(row, column), 1U);
                                               });
        const std::uint32_t total = block.exclusive_sums(shared.places);
        block.each_thread([&](int t) {
            if (t == 0) memory.block_places[block.index()] = total;
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

    /// Writes a Gaussian's record and, if it is visible, its rows of tiles; returns the number of
    /// tiles.
    RYE_DEVICE std::uint32_t reach(std::uint32_t i, TileSpans& spans) const {
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
        if (last - first > TileSpans::most) memory.footprint[i] = cover.f;
        std::uint32_t places = 0;
        for (int y = first; y < last; ++y) {
            const Span x = cover.columns(y, rows);
            places += static_cast<std::uint32_t>(x.end - x.begin);
            if (last - first > TileSpans::most) continue;
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

/// Computes the beginning of each tile's list, the beginning of each block's places, and the order
/// in which tiles are drawn: by length, the longest first, so that no long list begins last.
struct ScanKernel {
    static constexpr const char* name = "scan of tiles";
    static constexpr int threads = 1024, blocks = 1;
    /// Shared memory of a block.
    struct Shared {
        std::uint64_t wide[threads]; // a sum of 32 bits would hide too many entries
        std::uint32_t sums[threads];
        std::uint32_t in_class[threads]; ///< tiles of each length, the longest first
    };
    FrameMemory memory;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const std::uint32_t run = (memory.tiles + threads - 1) / threads;
        block.each_thread([&](int t) { shared.in_class[t] = 0; });
        block.each_thread([&](int t) {
            std::uint64_t n = 0;
            each(
                t, run, memory.tiles, [&](std::uint32_t k) { return *memory.counter(k); },
                [&](std::uint32_t, std::uint32_t here) {
                    n += here;
                    block.add(shared.in_class + class_of(here), 1U);
                });
            shared.wide[t] = n;
        });
        const std::uint64_t total = block.exclusive_sums(shared.wide);
        const bool fits = total <= memory.entries;
        block.exclusive_sums(shared.in_class);
        block.each_thread([&](int t) {
            if (t != 0) return;
            memory.begin[memory.tiles] = fits ? static_cast<std::uint32_t>(total) : 0U;
            memory.report->entries_low = static_cast<std::uint32_t>(total);
            memory.report->entries_high = static_cast<std::uint32_t>(total >> 32U);
            memory.report->overflow = fits ? 0U : 1U;
        });
        block.each_thread([&](int t) {
            auto at = static_cast<std::uint32_t>(shared.wide[t]);
            each(
                t, run, memory.tiles, [&](std::uint32_t k) { return *memory.counter(k); },
                [&](std::uint32_t k, std::uint32_t here) {
                    memory.begin[k] = *memory.counter(k) = fits ? at : 0U; // now where to put
                    at += fits ? here : 0U;
                    memory.order[block.add(shared.in_class + class_of(here), 1U)] = k;
                });
        });
        places(block, shared);
    }

  private:
    /// Replaces the number of places of each block of Gaussians by the number before it.
    template <class Block>
    RYE_DEVICE void places(Block& block, Shared& shared) const {
        const std::uint32_t run = (memory.blocks + threads - 1) / threads;
        block.each_thread([&](int t) {
            std::uint32_t n = 0;
            each(
                t, run, memory.blocks, [&](std::uint32_t k) { return memory.block_places[k]; },
                [&](std::uint32_t, std::uint32_t here) { n += here; });
            shared.sums[t] = n;
        });
        block.exclusive_sums(shared.sums);
        block.each_thread([&](int t) {
            std::uint32_t at = shared.sums[t];
            each(
                t, run, memory.blocks, [&](std::uint32_t k) { return memory.block_places[k]; },
                [&](std::uint32_t k, std::uint32_t here) {
                    memory.block_places[k] = at;
                    at += here;
                });
        });
    }

    /// Calls f(k, read(k)) for the numbers of thread t, whose reads run together.
    template <class Read, class F>
    RYE_DEVICE static void each(int t, std::uint32_t run, std::uint32_t n, const Read& read,
                                const F& f) {
        constexpr int at_once = 8;
        const std::uint32_t begin = static_cast<std::uint32_t>(t) * run;
        const std::uint32_t end = rye::min(begin + run, n);
        for (std::uint32_t b = begin; b < end; b += at_once) {
            std::uint32_t x[at_once];
            repeated<at_once>([&](auto k) { x[k] = b + k < end ? read(b + k) : 0U; });
            repeated<at_once>([&](auto k) {
                if (b + k < end) f(b + k, x[k]);
            });
        }
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
    static constexpr int threads = 128, blocks = 8;
    /// Shared memory of a block.
    struct Shared {
        BlockTiles tiles;
        std::uint32_t places[threads], key[threads];
    };
    int width, height;
    FrameMemory memory;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        if (memory.report->overflow != 0) return;
        const auto base = static_cast<std::uint32_t>(block.index()) * threads;
        block.each_thread([&](int t) {
            if (t == 0) shared.tiles.tall = 0;
        });
        block.each_thread([&](int t) {
            const std::uint32_t i = base + static_cast<std::uint32_t>(t);
            TileSpans& spans = shared.tiles.spans[t];
            spans.first = spans.rows = 0;
            std::uint32_t places = 0, key = 0;
            if (i < memory.count) {
                places = memory.places[i];
                spans = memory.spans[i];
                if (spans.rows > 0) key = depth_key(memory.record[i].shape.z);
            }
            shared.places[t] = places;
            shared.key[t] = key;
            shared.tiles.put(block, t, places);
        });
        block.exclusive_sums(shared.places);
        const std::uint32_t before = memory.block_places[block.index()];
        shared.tiles.template each<A::support>(
            block, memory.footprint + base, width, height,
            [&](int own, std::uint32_t rank, int row, int column) {
                const std::uint32_t place = before + shared.places[own] + rank;
                const std::uint32_t at = block.add(memory.counter(row, column), 1U);
                memory.owner[place] = base + static_cast<std::uint32_t>(own);
                reinterpret_cast<std::uint32_t*>(memory.touched)[place] = 0;
                memory.key[at] = std::uint64_t(shared.key[own]) << 32U | place;
            });
        block.each_thread([&](int t) {
            const std::uint32_t i = base + static_cast<std::uint32_t>(t);
            if (i < memory.count) memory.first[i] = before + shared.places[t];
        });
    }
};

} // namespace rye::detail
