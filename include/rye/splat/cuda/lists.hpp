// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/lists.hpp: from Gaussians to the entries of tiles, on a device: project and count,
/// scan, bin. Lists are those of TileLists; what is not decided here is the order within a tile's
/// list, which is sorted where it is drawn, by keys that are unique.
#pragma once

#include <rye/splat/cuda/lens.hpp>
#include <rye/splat/cuda/records.hpp>

namespace rye {

/// f(row, begin, end) of each row of tiles that a Gaussian reaches.
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

/// Gaussians of a block whose tiles its threads take together.
struct LargeGaussians {
    static constexpr int few = 16;            ///< tiles that a thread takes by itself
    std::uint32_t count;
    std::uint32_t index[128];
};

/// Projects Gaussians, and counts the entries of tiles.
template <class A, class D>
struct ProjectKernel {
    static constexpr const char* name = "project";
    static constexpr int threads = 128, blocks = 8;
    struct Shared {
        LargeGaussians large;
        std::uint32_t places[threads];
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
            if (t == 0) shared.large.count = 0;
        });
        block.each_thread([&](int t) {
            const std::uint32_t i = base + static_cast<std::uint32_t>(t);
            shared.places[t] = i < memory.count ? one(block, shared, i) : 0;
        });
        for (std::uint32_t k = 0; k < shared.large.count; ++k)
            block.each_thread([&](int t) {
                const std::uint32_t i = shared.large.index[k];
                each_span<A::support>(memory.spans[i], memory.footprint + i, width, height,
                                      [&](int row, int begin, int end) {
                                          for (int x = begin + t; x < end; x += threads)
                                              block.add(memory.tile_count + row * columns() + x, 1U);
                                      });
            });
        const std::uint32_t total = block.exclusive_sums(shared.places);
        block.each_thread([&](int t) {
            if (t == 0) memory.block_places[block.index()] = total;
        });
    }

  private:
    RYE_DEVICE int columns() const { return static_cast<int>(memory.columns); }

    /// How many tiles Gaussian i reaches.
    template <class Block>
    RYE_DEVICE std::uint32_t one(Block& block, Shared& shared, std::uint32_t i) const {
        TileSpans spans{};
        std::uint32_t places = 0;
        if (accuracy.non_finite != NonFinite::trust && !usable(i))
            block.add(&memory.report->non_finite, 1U);
        else
            places = reach(i, spans);
        memory.spans[i] = spans;
        memory.places[i] = places;
        if (spans.rows > TileSpans::most || places > LargeGaussians::few) {
            shared.large.index[block.add(&shared.large.count, 1U)] = i;
        } else {
            for (int y = 0; y < spans.rows; ++y)
                for (int x = spans.begin[y]; x < spans.end[y]; ++x)
                    block.add(memory.tile_count + (spans.first + y) * columns() + x, 1U);
        }
        return places;
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
        look(g.feature.data + Index(i) * g.channels(), g.channels());
        const float* const q = g.rotation.data + 4 * Index(i);
        return finite && (q[0] != 0.0F || q[1] != 0.0F || q[2] != 0.0F || q[3] != 0.0F);
    }

    /// The record, and, if it is visible, its rows of tiles; returns the number of tiles.
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

/// Where each tile's list begins, where each block's places begin, and the order in which tiles
/// are drawn: by size classes, the longest first, so that no long list begins last.
struct ScanKernel {
    static constexpr const char* name = "scan of tiles";
    static constexpr int threads = 1024, blocks = 1;
    static constexpr std::uint32_t classes = 64;
    struct Shared {
        std::uint32_t sums[threads];
        std::uint32_t in_class[classes];
        std::uint32_t low, high;
    };
    FrameMemory memory;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const std::uint32_t run = (memory.tiles + threads - 1) / threads;
        const auto range = [&](int t, std::uint32_t length, std::uint32_t n) {
            const std::uint32_t b = static_cast<std::uint32_t>(t) * length;
            return Array<std::uint32_t, 2>{{rye::min(b, n), rye::min(b + length, n)}};
        };
        // 64 bits in two halves: a sum of 32 bits would hide too many entries.
        block.each_thread([&](int t) {
            if (t < static_cast<int>(classes)) shared.in_class[t] = 0;
            shared.sums[t] = static_cast<std::uint32_t>(sum(range(t, run, memory.tiles)) & 0xFFFFU);
        });
        const std::uint64_t low = block.exclusive_sums(shared.sums);
        block.each_thread([&](int t) {
            shared.sums[t] = static_cast<std::uint32_t>(sum(range(t, run, memory.tiles)) >> 16U);
        });
        const std::uint64_t total = low + (std::uint64_t(block.exclusive_sums(shared.sums)) << 16U);
        const bool fits = total <= memory.entries;
        block.each_thread([&](int t) {
            shared.sums[t] = static_cast<std::uint32_t>(sum(range(t, run, memory.tiles)));
            const auto r = range(t, run, memory.tiles);
            for (std::uint32_t k = r[0]; k < r[1]; ++k)
                block.add(shared.in_class + class_of(memory.tile_count[k]), 1U);
        });
        block.exclusive_sums(shared.sums);
        block.each_thread([&](int t) {
            if (t != 0) return;
            std::uint32_t before = 0;
            for (std::uint32_t c = classes; c-- > 0;) {
                const std::uint32_t n = shared.in_class[c];
                shared.in_class[c] = before;
                before += n;
            }
            memory.begin[memory.tiles] = fits ? static_cast<std::uint32_t>(total) : 0U;
            memory.report->entries_low = static_cast<std::uint32_t>(total);
            memory.report->entries_high = static_cast<std::uint32_t>(total >> 32U);
            memory.report->overflow = fits ? 0U : 1U;
        });
        block.each_thread([&](int t) {
            std::uint32_t at = shared.sums[t];
            const auto r = range(t, run, memory.tiles);
            for (std::uint32_t k = r[0]; k < r[1]; ++k) {
                const std::uint32_t n = fits ? memory.tile_count[k] : 0U;
                memory.begin[k] = memory.cursor[k] = fits ? at : 0U;
                at += n;
                memory.order[block.add(shared.in_class + class_of(memory.tile_count[k]), 1U)] = k;
            }
        });
        places(block, shared);
    }

  private:
    /// Of the blocks of Gaussians: how many places come before.
    template <class Block>
    RYE_DEVICE void places(Block& block, Shared& shared) const {
        const std::uint32_t run = (memory.blocks + threads - 1) / threads;
        block.each_thread([&](int t) {
            const std::uint32_t b = static_cast<std::uint32_t>(t) * run;
            std::uint32_t n = 0;
            for (std::uint32_t k = b; k < b + run && k < memory.blocks; ++k)
                n += memory.block_places[k];
            shared.sums[t] = n;
        });
        block.exclusive_sums(shared.sums);
        block.each_thread([&](int t) {
            const std::uint32_t b = static_cast<std::uint32_t>(t) * run;
            std::uint32_t at = shared.sums[t];
            for (std::uint32_t k = b; k < b + run && k < memory.blocks; ++k) {
                const std::uint32_t n = memory.block_places[k];
                memory.block_places[k] = at;
                at += n;
            }
        });
    }

    RYE_DEVICE std::uint64_t sum(const Array<std::uint32_t, 2>& range) const {
        std::uint64_t n = 0;
        for (std::uint32_t k = range[0]; k < range[1]; ++k) n += memory.tile_count[k];
        return n;
    }
    /// By halves of powers of two.
    RYE_DEVICE static std::uint32_t class_of(std::uint32_t n) {
        std::uint32_t log = 0;
        for (std::uint32_t x = n; x > 1; x >>= 1U) ++log;
        return n < 2 ? n : rye::min(2 * log + (n >> (log - 1) & 1U), classes - 1);
    }
};

/// Puts every entry into its tile's list, in any order.
template <class A>
struct BinKernel {
    static constexpr const char* name = "bin";
    static constexpr int threads = 128, blocks = 8;
    struct Shared {
        LargeGaussians large;
        std::uint32_t places[threads];
    };
    int width, height;
    FrameMemory memory;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        if (memory.report->overflow != 0) return;
        const auto base = static_cast<std::uint32_t>(block.index()) * threads;
        block.each_thread([&](int t) {
            const std::uint32_t i = base + static_cast<std::uint32_t>(t);
            shared.places[t] = i < memory.count ? memory.places[i] : 0U;
            if (t == 0) shared.large.count = 0;
        });
        block.exclusive_sums(shared.places);
        const std::uint32_t before = memory.block_places[block.index()];
        block.each_thread([&](int t) {
            const std::uint32_t i = base + static_cast<std::uint32_t>(t);
            if (i >= memory.count) return;
            std::uint32_t place = before + shared.places[t];
            memory.first[i] = place;
            const TileSpans spans = memory.spans[i];
            if (spans.rows == 0) return;
            if (spans.rows > TileSpans::most || memory.places[i] > LargeGaussians::few) {
                shared.large.index[block.add(&shared.large.count, 1U)] = i;
                return;
            }
            const std::uint32_t key = depth_key(memory.record[i].shape.z);
            for (int y = 0; y < spans.rows; ++y)
                for (int x = spans.begin[y]; x < spans.end[y]; ++x)
                    put(block, tile(spans.first + y, x), key, place++, i);
        });
        for (std::uint32_t k = 0; k < shared.large.count; ++k)
            block.each_thread([&](int t) {
                const std::uint32_t i = shared.large.index[k];
                std::uint32_t place = memory.first[i];
                const std::uint32_t key = depth_key(memory.record[i].shape.z);
                each_span<A::support>(
                    memory.spans[i], memory.footprint + i, width, height,
                    [&](int row, int begin, int end) {
                        for (int x = begin + t; x < end; x += threads)
                            put(block, tile(row, x), key,
                                place + static_cast<std::uint32_t>(x - begin), i);
                        place += static_cast<std::uint32_t>(end - begin);
                    });
            });
    }

  private:
    RYE_DEVICE std::uint32_t tile(int row, int column) const {
        return static_cast<std::uint32_t>(row) * memory.columns +
               static_cast<std::uint32_t>(column);
    }
    template <class Block>
    RYE_DEVICE void put(Block& block, std::uint32_t tile, std::uint32_t key, std::uint32_t place,
                        std::uint32_t i) const {
        const std::uint32_t at = block.add(memory.cursor + tile, 1U);
        memory.key[at] = std::uint64_t(key) << 32U | place;
        memory.owner[place] = i;
        memory.slot[place] = no_slot;
    }
};

} // namespace rye
