// SPDX-License-Identifier: Apache-2.0
/// rye/interactive/redraw.hpp: incremental rendering. Changed Gaussians are projected again and
/// binned into the lists of their tiles, and only tiles that their old or new footprints overlap
/// are blended again: tiles with few changes only in the strips that these overlap, and not at all
/// if all pixels saturate before the first change. Lists have the entries and order of
/// Rasterizer::forward with the same kernels, so images are equal bit for bit. Pixel units. Memory:
/// the trace and scratch of one render, a second copy of the lists, and the changes once more.
#pragma once

#include <span>
#include <string>
#include <vector>

#include <rye/core/region.hpp>
#include <rye/splat/lanes.hpp>
#include <rye/interactive/tile_changes.hpp>

namespace rye {

/// Work of the last call.
struct RedrawWork {
    Index projected = 0;  ///< Gaussians projected
    Index blended = 0;    ///< tiles blended, whole or in part
    Index whole = 0;      ///< tiles blended whole
};

/// Render that is updated: only tiles whose Gaussians changed are drawn again, with the bits of a
/// whole render.
template <Backend B, AccuracyPolicy A, Real T>
class Redraw {
    static_assert(A::order == BlendOrder::by_centre && A::depth_bits <= 8 * int(sizeof(T)),
                  "Redraw sorts lists by the centres' depths in the Gaussians' own scalar");
    static_assert(!A::outputs.contributor, "Redraw renders no contributors");

  public:
    explicit Redraw(const B& backend = {}, const Rasterizer<A>& rasterizer = {})
        : backend_(backend),
          rasterizer_(rasterizer) {}

    /// Returns the images. Their trace does not suit a vjp: the lists have no slots for partial
    /// gradients.
    const Raster<T, A::outputs>& raster() const { return raster_; }
    /// Returns the pixels that the last call may have changed.
    const Region& region() const { return region_; }
    const RedrawWork& work() const { return work_; }
    /// Returns true if there is an image to update.
    bool drawn() const { return drawn_; }

    /// Draws with this dilation from now on [px^2]; after another the image is to be drawn anew.
    void set_dilation(double dilation) {
        drawn_ = drawn_ && dilation == rasterizer_.accuracy.dilation;
        rasterizer_.accuracy.dilation = dilation;
    }

    /// Renders the whole image.
    void draw(const Gaussians<T>& g, const Pinhole<T>& camera, const VecX<T>& background) {
        drawn_ = false;
        rasterizer_.forward_into(backend_, g, camera, background, raster_, &scratch_);
        camera_ = camera;
        background_ = background;
        const RasterTrace<T>& trace = raster_.trace;
        key_.resize(trace.members.size());
        for (std::size_t m = 0; m < key_.size(); ++m)
            key_[m] = detail::depth_key(trace.members[m].splat.depth);
        moved_.assign(key_.size(), 0);
        every_tile();
        count(g.count());
        drawn_ = true;
    }

    /// Renders the same Gaussians and camera over another background.
    void redraw_background(const Gaussians<T>& g, const VecX<T>& background) {
        check(g, background);
        background_ = background;
        every_tile();
        blend(g, 0);
    }

    /// Updates to Gaussians that differ from the last ones only in columns `changed`, ascending.
    void redraw(const Gaussians<T>& g, std::span<const Index> changed) {
        check(g, background_);
        blended_.clear();
        drawn_strips_.clear();
        region_ = Region(camera_.width, camera_.height);
        work_ = {};
        if (changed.empty()) return;
        drawn_ = false;  // invalid until the update is complete
        tiles_.assign(static_cast<std::size_t>(raster_.trace.lists.tiles()), {});
        for (const Index i : changed) leave(i);
        project(g, changed);
        for (std::size_t k = 0; k < changed.size(); ++k)
            if (part_scratch_.state[k] == Visibility::visible)
                each_tile(part_scratch_, k, [&](std::size_t t) { ++tiles_[t].entered; });
        if constexpr (LaneBackend<B, T>) find_strips(changed);
        for (std::size_t k = 0; k < changed.size(); ++k) enter(changed[k], k);
        sort_fresh(changed);
        merge_lists();
        for (const Index i : changed)
            if (const std::uint32_t m = member(i); m != no_member) moved_[m] = 0;
        blend(g, static_cast<Index>(changed.size()));
        drawn_ = true;
    }

    /// Returns the size of all cached data [bytes].
    std::size_t bytes() const {
        const auto of = [](const auto&... v) {
            return (std::size_t(0) + ... + (v.capacity() * sizeof(v[0])));
        };
        const RasterTrace<T>& t = raster_.trace;
        Index numbers = raster_.feature.pixels.size() + 2 * raster_.alpha.pixels.size();
        Gaussians<T>::fields([&](const std::string&, const Columns<T>& a) { numbers += a.size(); },
                             part_);
        std::size_t sum = static_cast<std::size_t>(numbers) * sizeof(T) +
                          of(t.members, t.member, t.used, key_, moved_, tiles_, order_,
                             order_buffer_, fresh_,
                             few_.members, cursor_, found_, blended_, drawn_strips_);
        for (const TileLists* l : {&t.lists, &next_, &few_.lists})
            sum += of(l->begin, l->entry, l->first);
        for (const RasterScratch<T>* s : {&scratch_, &part_scratch_})
            sum += of(s->candidates, s->footprints, s->state, s->first_tile);
        return sum;
    }

  private:
    using Key = typename RasterScratch<T>::Key;

    static std::size_t at(Index i) { return static_cast<std::size_t>(i); }
    std::uint32_t member(Index i) const { return raster_.trace.member[at(i)]; }
    bool visible(Index i) const { return scratch_.state[at(i)] == Visibility::visible; }
    void check(const Gaussians<T>& g, const VecX<T>& background) const {
        require(drawn_ && g.count() == static_cast<Index>(raster_.trace.member.size()) &&
                    g.channels() == raster_.feature.channels() &&
                    background.size() == g.channels(),
                "Redraw", "the Gaussians or the background differ in shape from those of the last "
                          "image; call draw() first");
    }

    /// Calls f(tile) for every tile that visible candidate k overlaps.
    template <class F>
    void each_tile(const RasterScratch<T>& scratch, std::size_t k, const F& f) const {
        const Index columns = raster_.trace.lists.columns;
        each_tile_row<A::support, T>(
            camera_.width, camera_.height, scratch.candidates[k].rows,
            [&]() -> const Footprint<T>& { return scratch.footprints[k]; },
            [&](const detail::TileRowSpan& s) {
                for (int x = s.begin; x < s.end; ++x) f(at(s.row * columns + x));
            });
    }

    /// Removes the old footprint of Gaussian i.
    void leave(Index i) {
        if (!visible(i)) return;
        moved_[member(i)] = 1;
        each_tile(scratch_, at(i), [&](std::size_t t) { ++tiles_[t].left; });
    }

    /// Gathers the changed Gaussians and projects them.
    void project(const Gaussians<T>& g, std::span<const Index> changed) {
        const Index n = static_cast<Index>(changed.size());
        Gaussians<T>::fields([&](const std::string&, Columns<T>& to, const Columns<T>& from) {
            to.resize(from.rows(), n);
            const Index rows = from.rows();
            for (Index k = 0; k < n; ++k)
                std::copy_n(from.data() + changed[at(k)] * rows, rows, to.data() + k * rows);
        }, part_, g);
        rasterizer_.project_into(backend_, part_, camera_, part_scratch_);
    }

    /// Finds the strips that old and new splats overlap in tiles with few changes, with the code of
    /// blending: the changes become a small scene.
    void find_strips(std::span<const Index> changed) {
        using V = typename B::template batch<T>;
        TileLists& lists = few_.lists;
        lists.columns = raster_.trace.lists.columns;
        lists.rows = raster_.trace.lists.rows;
        lists.begin.resize(tiles_.size() + 1);
        Index sum = 0;
        std::uint32_t masks = 0;
        for (std::size_t t = 0; t < tiles_.size(); ++t) {
            lists.begin[t] = sum;
            if (!tiles_[t].few()) continue;
            sum += tiles_[t].left + tiles_[t].entered;
            tiles_[t].mask = masks++;
        }
        lists.begin[tiles_.size()] = sum;
        found_.assign(masks, {});
        if (masks == 0) return;
        few_.members.resize(at(sum));
        lists.entry.resize(at(sum));
        for (std::size_t e = 0; e < lists.entry.size(); ++e)
            lists.entry[e] = {static_cast<std::uint32_t>(e), 0};
        cursor_.assign(lists.begin.begin(), lists.begin.end() - 1);
        const auto bin = [&](const RasterScratch<T>& from, std::size_t k) {
            each_tile(from, k, [&](std::size_t t) {
                if (tiles_[t].mask != detail::TileChange::whole_tile)
                    few_.members[at(cursor_[t]++)] = from.candidates[k];
            });
        };
        for (std::size_t k = 0; k < changed.size(); ++k) {
            if (visible(changed[k])) bin(scratch_, at(changed[k]));
            if (part_scratch_.state[k] == Visibility::visible) bin(part_scratch_, k);
        }
        const Scene<T> scene = rasterizer_.scene_of(part_, camera_, background_, few_);
        const auto canvas = scratch_.workspaces.template acquire<detail::LaneCanvas<V>>();
        detail::LaneGroup<V>& group = (*canvas).group;
        for (std::size_t t = 0; t < tiles_.size(); ++t) {
            if (tiles_[t].mask == detail::TileChange::whole_tile) continue;
            const Index tile = static_cast<Index>(t), end = scene.end(tile);
            const detail::Strips<V> strips(scene, tile);
            detail::StripMask& mask = found_[tiles_[t].mask];
            for (Index k = scene.begin(tile); k < end; k += detail::LaneGroup<V>::most) {
                const Index next = std::min<Index>(end, k + detail::LaneGroup<V>::most);
                group.template fill<0>(scene, strips, scene.top(tile), k, next, [](Index) {});
                for (int s = 0; s < detail::Strips<V>::count; ++s)
                    if (group.reaching[s] != 0) mask.set(s);
            }
        }
    }

    /// Adds the new footprint of Gaussian i, number k of the changed ones.
    void enter(Index i, std::size_t k) {
        RasterTrace<T>& trace = raster_.trace;
        const Visibility now = part_scratch_.state[k];
        trace.non_finite += Index(now == Visibility::non_finite) -
                            Index(scratch_.state[at(i)] == Visibility::non_finite);
        if (rasterizer_.accuracy.non_finite == NonFinite::fail && trace.non_finite > 0)
            throw Error("rasterizer: Gaussian " + std::to_string(i) +
                        " has a number that is not finite");
        scratch_.state[at(i)] = now;
        if (now != Visibility::visible) return;
        VisibleGaussian<T>& drawn = scratch_.candidates[at(i)];
        drawn = part_scratch_.candidates[k];
        drawn.source = static_cast<std::uint32_t>(i);
        scratch_.footprints[at(i)] = part_scratch_.footprints[k];
        const Key key = detail::depth_key(drawn.splat.depth);
        if (member(i) == no_member) {
            trace.member[at(i)] = static_cast<std::uint32_t>(trace.members.size());
            trace.members.push_back(drawn);
            key_.push_back(key);
            moved_.push_back(1);
        } else {
            const std::uint32_t m = member(i);
            trace.members[m] = drawn;
            key_[m] = key;
            moved_[m] = 1;
        }
    }

    /// Bins the entering Gaussians into their tiles, near to far, ties by index.
    void sort_fresh(std::span<const Index> changed) {
        order_.clear();
        for (std::size_t k = 0; k < changed.size(); ++k)
            if (visible(changed[k]))
                order_.push_back({key_[member(changed[k])], static_cast<std::uint32_t>(k)});
        order_buffer_.resize(order_.size());
        sort_by_key(order_.data(), order_buffer_.data(), static_cast<Index>(order_.size()));
        std::uint32_t sum = 0;
        for (detail::TileChange& t : tiles_) {
            t.fresh = sum;
            sum += t.entered;
        }
        fresh_.resize(sum);
        for (const Keyed<Key>& k : order_) {
            const Index i = changed[k.value];
            const std::uint32_t m = member(i);
            each_tile(scratch_, at(i),
                      [&](std::size_t t) { fresh_[tiles_[t].fresh++] = {m, 0}; });
        }
        for (detail::TileChange& t : tiles_) t.fresh -= t.entered;
    }

    /// Builds the new lists: old entries that stayed, merged with those that enter.
    void merge_lists() {
        TileLists& old = raster_.trace.lists;
        next_.columns = old.columns;
        next_.rows = old.rows;
        next_.begin.resize(old.begin.size());
        Index entries = 0;
        for (std::size_t t = 0; t < tiles_.size(); ++t) {
            next_.begin[t] = entries;
            entries += old.begin[t + 1] - old.begin[t] - Index(tiles_[t].left) +
                       Index(tiles_[t].entered);
        }
        next_.begin[tiles_.size()] = entries;
        TileLists::check_entries(entries, rasterizer_.accuracy.max_memory);
        next_.entry.resize(at(entries));
        for_chunks(backend_.threads, old.tiles(), 8, [&](Index b, Index e, Index) {
            for (Index t = b; t < e; ++t) merge_list(at(t));
        });
        std::swap(old.begin, next_.begin);
        std::swap(old.entry, next_.entry);
        for (std::size_t t = 0; t < tiles_.size(); ++t) {
            if (!tiles_[t].redraw) continue;
            const bool whole = tiles_[t].mask == detail::TileChange::whole_tile;
            if (!whole && found_[tiles_[t].mask].none()) continue;
            blended_.push_back(static_cast<Index>(t));
            drawn_strips_.push_back(whole ? detail::all_strips : found_[tiles_[t].mask]);
        }
    }

    void merge_list(std::size_t t) {
        detail::TileChange& change = tiles_[t];
        const TileLists& old = raster_.trace.lists;
        using Entry = TileLists::Entry;
        const Entry* const from = old.entry.data() + old.begin[t];
        const Entry* const end = old.entry.data() + old.begin[t + 1];
        Entry* const to = next_.entry.data() + next_.begin[t];
        if (!change.changes()) {
            std::copy(from, end, to);
            return;
        }
        const Index before = end - from;
        const Index same = detail::merge_entries<Entry>(
            {from, end}, {fresh_.data() + change.fresh, change.entered}, to,
            [&](const Entry& e) { return moved_[e.member] != 0; },
            [&](const Entry& x, const Entry& y) { return nearer(x.member, y.member); });
        // Fewer entries were read than exist: all pixels saturated within unchanged entries.
        const Index used = raster_.trace.used[t];
        change.redraw = !(used < before && used <= same);
    }

    /// Returns true if a is before b in the lists: by depth, then index.
    bool nearer(std::uint32_t a, std::uint32_t b) const {
        const RasterTrace<T>& trace = raster_.trace;
        return key_[a] < key_[b] ||
               (key_[a] == key_[b] && trace.members[a].source < trace.members[b].source);
    }

    void every_tile() {
        blended_.clear();
        for (Index t = 0; t < raster_.trace.lists.tiles(); ++t) blended_.push_back(t);
        drawn_strips_.assign(blended_.size(), detail::all_strips);
    }

    void blend(const Gaussians<T>& g, Index projected) {
        rasterizer_.blend_into(
            backend_, rasterizer_.scene_of(g, camera_, background_, raster_.trace),
            {blended_.data(), drawn_strips_.data(), 0, static_cast<Index>(blended_.size())},
            raster_, scratch_);
        count(projected);
    }

    /// Counts the work and the changed region; marks the whole list of a tile blended in part as
    /// used.
    void count(Index projected) {
        work_ = {projected, static_cast<Index>(blended_.size()), 0};
        region_ = Region(camera_.width, camera_.height);
        const TileLists& lists = raster_.trace.lists;
        for (std::size_t k = 0; k < blended_.size(); ++k) {
            const Index t = blended_[k];
            const int x = static_cast<int>(t % lists.columns) * detail::tile_edge;
            const int y = static_cast<int>(t / lists.columns) * detail::tile_edge;
            const detail::StripMask& strips = drawn_strips_[k];
            if (strips.words == detail::all_strips.words) {
                ++work_.whole;
                region_.add({x, y, x + detail::tile_edge, y + detail::tile_edge});
                continue;
            }
            raster_.trace.used[at(t)] = lists.begin[at(t) + 1] - lists.begin[at(t)];
            if constexpr (LaneBackend<B, T>) {
                using S = detail::Strips<typename B::template batch<T>>;
                for (int s = 0; s < S::count; ++s) {
                    const int left = x + S::side(s) * S::wide, top = y + S::row(s);
                    if (strips.has(s)) region_.add({left, top, left + S::wide, top + S::high});
                }
            }
        }
    }

    B backend_;
    Rasterizer<A> rasterizer_;
    Raster<T, A::outputs> raster_;
    RasterScratch<T> scratch_, part_scratch_;
    Gaussians<T> part_;                ///< the changed ones, gathered
    Pinhole<T> camera_;
    VecX<T> background_;
    std::vector<Key> key_;             ///< depth of each member
    std::vector<std::uint8_t> moved_;  ///< true for members that changed, during a redraw
    std::vector<detail::TileChange> tiles_;
    std::vector<Keyed<Key>> order_, order_buffer_;  ///< the changed ones, by depth
    std::vector<TileLists::Entry> fresh_;  ///< entries that enter tiles, tile by tile
    TileLists next_;
    RasterTrace<T> few_;               ///< the changes of tiles with few of them
    std::vector<Index> cursor_;
    std::vector<detail::StripMask> found_; ///< strips that they overlap
    std::vector<Index> blended_;
    std::vector<detail::StripMask> drawn_strips_;
    Region region_{0, 0};
    RedrawWork work_;
    bool drawn_ = false;
};

} // namespace rye
