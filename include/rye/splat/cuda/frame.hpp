// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/frame.hpp: device memory of a frame, which a render fills and its vjp reads. It
/// is reserved when a frame is shaped, never while it is drawn.
#pragma once

#include <algorithm>
#include <cstdint>
#include <string>

#include <rye/splat/cuda/records.hpp>

namespace rye {

/// Counts of a finished frame.
struct DeviceFrameCost {
    std::int64_t entries = 0;    ///< pairs of a tile and a Gaussian
    std::int64_t groups = 0;     ///< groups of 16 visits of a strip, and at most one a strip more
    std::int64_t non_finite = 0; ///< Gaussians left out
};

/// Extents for which a frame is made; they determine its memory.
struct DeviceFrameShape {
    std::size_t gaussians, tiles;
    std::size_t entries, groups; ///< capacities; no groups: no vjp
    std::size_t stride;          ///< numbers of a slot, ChannelLayout<C>::stride

    std::size_t blocks() const { return (gaussians + 127) / 128; }
    /// Returns the count of 32-bit words: of Gaussians and tiles, of counters, of entries, of
    /// groups.
    std::size_t words() const {
        return gaussians + 2 * blocks() + std::size_t(2 + detail::tile_strips) * tiles + 2;
    }
    std::size_t counters() const {
        return tiles * detail::FrameMemory::apart + sizeof(FrameReport) / 4 +
               detail::FrameMemory::classes;
    }
    std::size_t entry_words() const {
        return groups > 0 ? std::size_t(2 + detail::tile_strips) * entries + entries / 8 + 1
                          : entries;
    }
    std::size_t group_words() const {
        return groups * std::size_t(2 * detail::group_visits + 1) +
               (groups > 0 ? detail::FrameMemory::classes * tiles * detail::tile_strips : 0U);
    }
    std::size_t transmittances() const { return groups * 64; }
    std::size_t partials() const { return groups * std::size_t(detail::group_visits) * stride; }

    /// Returns the device memory of the frame [bytes]; each array has one number more.
    std::size_t bytes() const {
        return (gaussians + 1) * (sizeof(detail::SplatRecord) + sizeof(detail::TileSpans) +
                                  sizeof(Footprint<float>)) +
               (entries + 1) * sizeof(std::uint64_t) +
               4 * (words() + counters() + entry_words() + group_words() + transmittances() +
                    partials() + 6);
    }
};

/// A frame's memory, which a render fills and its vjp reads. Device: CudaDevice, or EmulatedDevice.
template <class Device>
struct DeviceFrame {
    explicit DeviceFrame(const Device& on = {}) : device(on) {}

    Device device;
    bool for_vjp = true; ///< true if a render keeps what its vjp reads
    /// Capacities for entries and for groups of visits; `finish` raises them.
    std::int64_t entry_capacity = 0, group_capacity = 0;
    DeviceFrameCost cost = {}; ///< counts of the last finished frame

    /// Makes room for n Gaussians in an image, with `stride` numbers a slot; guesses the number of
    /// entries.
    void shape(const CudaQueue& queue, Index n, int width, int height, int stride) {
        m.count = static_cast<std::uint32_t>(n);
        m.columns = static_cast<std::uint32_t>(tiles_across(width));
        m.tiles = m.columns * static_cast<std::uint32_t>(tiles_across(height));
        if (entry_capacity == 0) entry_capacity = 8 * n + 8 * std::int64_t(m.tiles) + 1024;
        if (group_capacity == 0) group_capacity = entry_capacity / 16 + 8 * std::int64_t(m.tiles);
        const DeviceFrameShape of{static_cast<std::size_t>(n), m.tiles,
                                  static_cast<std::size_t>(entry_capacity),
                                  for_vjp ? static_cast<std::size_t>(group_capacity) : 0U,
                                  static_cast<std::size_t>(stride)};
        m.blocks = static_cast<std::uint32_t>(of.blocks());
        place(queue, records_, m.record, of.gaussians);
        place(queue, spans_, m.spans, of.gaussians);
        place(queue, footprints_, m.footprint, of.gaussians);
        place(queue, words_, m.places, of.words());
        m.block_places = m.places + of.gaussians;
        m.block_ranks = m.block_places + m.blocks;
        m.begin = m.block_ranks + m.blocks;
        m.order = m.begin + of.tiles + 1;
        m.last = m.order + of.tiles;
        place(queue, counters_, m.counters, of.counters());
        m.report =
            reinterpret_cast<FrameReport*>(m.counters + of.tiles * detail::FrameMemory::apart);
        m.walked = reinterpret_cast<std::uint32_t*>(m.report + 1);
        place(queue, keys_, m.key, of.entries);
        std::uint32_t* words = nullptr;
        place(queue, entry_words_, words, of.entry_words());
        if (of.groups > 0) { // slots begin where 16 bytes do
            m.slot = reinterpret_cast<detail::StripSlots*>(words);
            words += std::size_t(detail::tile_strips) * of.entries;
            m.owner = words + of.entries;
            m.touched = m.owner + of.entries;
        }
        m.sorted = m.rank = words;
        m.entries = static_cast<std::uint32_t>(of.entries);
        m.groups = static_cast<std::uint32_t>(of.groups);
        place(queue, group_words_, m.visits, of.group_words());
        m.before = m.visits + of.groups * std::size_t(2 * detail::group_visits);
        m.walked_of = m.before + of.groups;
        place(queue, transmittance_, m.transmittance, of.transmittances());
        place(queue, partial_, m.partial, of.partials());
    }

    /// Returns the number of passes in which lists are made: what one writes fits the cache, where
    /// numbers that come one by one to a line of memory gather.
    std::uint32_t passes() const {
        if (m.tiles == 0) return 1;
        const std::uint32_t most = std::min(m.tiles / m.columns, 8U);
        return std::clamp((m.entries - 1) / keys_of_pass + 1, 1U, most);
    }
    std::uint32_t keys_of_pass = 4U << 20U; ///< keys that a pass writes, at most about

    /// Waits for the frame; returns true if everything fitted. Otherwise makes room, and the frame
    /// must be drawn again.
    bool finish(const CudaQueue& queue, std::int64_t max_entries = std::int64_t(1) << 31,
                NonFinite non_finite = NonFinite::cull) {
        FrameReport r{};
        device.fetch(queue, &r, m.report, sizeof r);
        return take(r, max_entries, non_finite);
    }
    /// The same with a report that has come to the host by the caller's own copy of `m.report`.
    bool take(const FrameReport& r, std::int64_t max_entries = std::int64_t(1) << 31,
              NonFinite non_finite = NonFinite::cull) {
        cost = {static_cast<std::int64_t>(std::uint64_t(r.entries_high) << 32U | r.entries_low),
                r.groups, r.non_finite};
        if (non_finite == NonFinite::fail && cost.non_finite > 0)
            throw Error("rasterizer: got " + std::to_string(cost.non_finite) +
                        " Gaussians with a number that is not finite, expected none");
        if (cost.entries > std::min(max_entries, most_entries))
            throw Error("rasterizer: got " + std::to_string(cost.entries) +
                        " pairs of a tile and a Gaussian, expected at most " +
                        std::to_string(std::min(max_entries, most_entries)) +
                        ": the Gaussians are too large for the image");
        return make_room(cost.entries, cost.groups);
    }
    /// Makes room for frames of that many entries and groups, from the next frame on; returns true
    /// if there was enough.
    bool make_room(std::int64_t entries, std::int64_t groups) {
        const bool fits = entries <= m.entries && (!for_vjp || groups <= m.groups);
        if (entries > m.entries) entry_capacity = grown(entries);
        if (for_vjp && groups > m.groups) group_capacity = grown(groups);
        return fits;
    }

    /// Returns the memory that is held [bytes].
    std::size_t bytes() const {
        return records_.bytes() + spans_.bytes() + footprints_.bytes() + words_.bytes() +
               counters_.bytes() + keys_.bytes() + entry_words_.bytes() + group_words_.bytes() +
               transmittance_.bytes() + partial_.bytes();
    }

    detail::FrameMemory m{};

  private:
    static constexpr std::int64_t most_entries = 0xFFFFFFF0;

    static std::int64_t grown(std::int64_t need) { return need + need / 4 + 64; }
    template <class T>
    static void place(const CudaQueue& queue, DeviceBuffer<T>& buffer, T*& at, std::size_t n) {
        buffer.reserve(queue, n + 1);
        at = buffer.data();
    }

    DeviceBuffer<detail::SplatRecord> records_;
    DeviceBuffer<detail::TileSpans> spans_;
    DeviceBuffer<Footprint<float>> footprints_;
    DeviceBuffer<std::uint32_t> words_, counters_, entry_words_, group_words_;
    DeviceBuffer<std::uint64_t> keys_;
    DeviceBuffer<float> transmittance_, partial_;
};

} // namespace rye
