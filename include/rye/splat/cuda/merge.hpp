// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/merge.hpp: gradients of Gaussians from their slots, in the order of tiles, and
/// back through the projection; and that of the background.
#pragma once

#include <rye/splat/cuda/lists.hpp>

namespace rye::detail {

/// Merges slots to gradients. C: channels of the layout. Writes channels [first, first + channels)
/// of the features' gradient; with `add`, adds the gradients of shape and opacity to those present.
template <class A, class D, int C>
struct MergeKernel {
    using Layout = ChannelLayout<C>;
    static constexpr const char* name = "merge of gradients";
    static constexpr int threads = 128, blocks = Layout::products ? 6 : 7;
    static constexpr int quads = Layout::stride / 4;
    /// Number of places that a thread tests together: the blocks of a head have 4.1 places a
    /// Gaussian.
    static constexpr int of_thread = 5;
    static constexpr std::uint32_t chunk = of_thread * threads;
    /// Parts of the slots that are added at once, each by a thread for every four numbers.
    static constexpr std::uint32_t parts = threads / quads;
    /// Shared memory of a block.
    struct Shared {
        alignas(16) float sum[threads][Layout::stride];
        Quad4 carry[parts * quads];   ///< sums of the Gaussian that a part begins within
        std::uint32_t carried[parts]; ///< that Gaussian, or none_of
        std::uint32_t found[threads]; ///< a thread's slots, then those of threads before it
        std::uint32_t slot[chunk * tile_strips];
        std::uint8_t own[chunk * tile_strips]; ///< the slot's Gaussian
    };
    DeviceGaussians<const float> g;
    DeviceGaussians<float> out;
    DeviceLens<D> lens;
    FrameMemory memory;
    Index first_channel;
    int channels;
    bool add;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const auto base = static_cast<std::uint32_t>(block.index()) * threads;
        if (memory.report->overflow != 0) return;
        block.each_thread([&](int t) {
            const std::uint32_t i = base + static_cast<std::uint32_t>(t);
            shared.found[t] = i < memory.count ? memory.places[i] : 0U;
            for (float& x : shared.sum[t]) x = 0;
        });
        const std::uint32_t places = block.exclusive_sums(shared.found);
        const std::size_t start = memory.block_places[block.index()];
        for (std::uint32_t at = 0; at < places; at += chunk) {
            const std::uint32_t found =
                find(block, shared, base, start + at, rye::min(places - at, std::uint32_t(chunk)));
            block.each_thread([&](int t) { add_part(shared, t / quads, t % quads, found); });
            block.each_thread([&](int t) { add_carries(shared, t / quads, t % quads); });
        }
        block.each_thread([&](int t) {
            for (int k = t; k < threads * channels; k += threads) {
                const std::uint32_t i = base + static_cast<std::uint32_t>(k / channels);
                if (i < memory.count)
                    out.feature.data[Index(i) * out.feature.rows + first_channel + k % channels] =
                        shared.sum[k / channels][Layout::head + k % channels];
            }
            const std::uint32_t i = base + static_cast<std::uint32_t>(t);
            if (i < memory.count) pull_back(shared.sum[t], i);
        });
    }

  private:
    /// Lists the slots of a chunk of places, in the order of places, then of strips; returns how
    /// many.
    template <class Block>
    RYE_DEVICE std::uint32_t find(Block& block, Shared& shared, std::uint32_t base,
                                  std::size_t from, std::uint32_t count) const {
        struct Found {
            std::uint32_t flags[std::size_t(of_thread)], owner[std::size_t(of_thread)];
            StripSlots slots[std::size_t(of_thread)];
        };
        auto own = block.template of_threads<Found>();
        block.each_thread([&](int t) {
            std::uint32_t n = 0;
            Found& f = own[t];
            repeated<of_thread>([&](auto e) {
                const std::uint32_t place = of_thread * static_cast<std::uint32_t>(t) + e;
                const std::size_t at = from + place;
                f.flags[e] =
                    place < count ? memory.touched[at / 8] >> (at % 8 * tile_strips) & 15U : 0U;
            });
            // All under way together, and while the block counts.
            repeated<of_thread>([&](auto e) {
                const std::size_t place =
                    from + of_thread * static_cast<std::uint32_t>(t) + std::uint32_t(e);
                if (f.flags[e] == 0) return;
                f.owner[e] = memory.owner[place] - base;
                f.slots[e] = memory.slot[place];
            });
            repeated<of_thread>(
                [&](auto e) { n += static_cast<std::uint32_t>(Block::bits_set(f.flags[e])); });
            shared.found[t] = n;
        });
        const std::uint32_t total = block.exclusive_sums(shared.found);
        block.each_thread([&](int t) {
            std::uint32_t at = shared.found[t];
            repeated<of_thread>([&](auto e) {
                repeated<tile_strips>([&](auto s) {
                    if ((own[t].flags[e] >> s & 1U) == 0) return;
                    shared.own[at] = static_cast<std::uint8_t>(own[t].owner[e]);
                    shared.slot[at++] = own[t].slots[e].of[s];
                });
            });
        });
        return total;
    }

    /// Adds four numbers of the slots of a part, which may begin and end within a Gaussian's: those
    /// that begin before it are kept apart, so that each sum has one writer.
    RYE_DEVICE void add_part(Shared& shared, int part, int quad, std::uint32_t found) const {
        if (part >= int(parts)) return;
        const auto* const partial = reinterpret_cast<const Quad4*>(memory.partial);
        const std::uint32_t length = (found + parts - 1) / parts;
        const std::uint32_t begin = static_cast<std::uint32_t>(part) * length;
        const std::uint32_t end = rye::min(begin + length, found);
        std::uint32_t now = begin < end ? shared.own[begin] : none_of;
        bool carried = begin > 0 && begin < end && shared.own[begin - 1] == now;
        if (quad == 0) shared.carried[part] = carried ? now : none_of;
        Quad4 sum{0, 0, 0, 0};
        const auto put = [&] {
            if (carried) {
                shared.carry[part * quads + quad] = sum;
            } else if (now != none_of) {
                Quad4& to = reinterpret_cast<Quad4*>(shared.sum[now])[quad];
                to = added(to, sum);
            }
            carried = false;
            sum = {0, 0, 0, 0};
        };
        // A few at a time: their loads are under way together.
        constexpr int at_once = 6;
        for (std::uint32_t k = begin; k < end; k += at_once) {
            Quad4 p[at_once];
            repeated<at_once>([&](auto e) {
                if (k + e < end)
                    p[e] = partial[std::size_t(shared.slot[k + e]) * quads +
                                   static_cast<std::size_t>(quad)];
            });
            repeated<at_once>([&](auto e) {
                if (k + e >= end) return;
                const std::uint32_t own = shared.own[k + e];
                if (own != now) put();
                now = own;
                sum = added(sum, p[e]);
            });
        }
        put();
    }
    /// Adds what parts have kept apart, in their order.
    RYE_DEVICE void add_carries(Shared& shared, int part, int quad) const {
        if (part >= int(parts)) return;
        const std::uint32_t own = shared.carried[part];
        if (own == none_of || (part > 0 && shared.carried[part - 1] == own)) return;
        Quad4& to = reinterpret_cast<Quad4*>(shared.sum[own])[quad];
        for (; part < int(parts) && shared.carried[part] == own; ++part)
            to = added(to, shared.carry[part * quads + quad]);
    }
    RYE_DEVICE static Quad4 added(const Quad4& a, const Quad4& b) {
        return {a.x + b.x, a.y + b.y, a.z + b.z, a.w + b.w};
    }

    RYE_DEVICE void pull_back(const float* sum, std::uint32_t i) const {
        Shape<float> d{Vec3<float>(0, 0, 0), Quat<float>(0, 0, 0, 0), Vec3<float>(0, 0, 0)};
        float opacity = 0;
        bool any = false; // most Gaussians of a crowd are hidden, and not read again
        for (int k = 0; k < 7; ++k) any = any || sum[k] != 0.0F;
        if (any) {
            Splat<float> splat{};
            const SplatRecord s = memory.record[i];
            splat.ux = s.place.z;
            splat.vx = s.place.w;
            splat.vy = s.shape.x;
            const SplatCotangent<float> c{sum[0], sum[1], sum[2], sum[3], sum[4], sum[5], sum[6]};
            typename DeviceLens<D>::Held held;
            lens.put(held);
            d = project_vjp<A::antialias>(ProjectKernel<A, D>::shape_of(g, i), held.projector,
                                          screen_cotangent(splat, c), c.alpha);
            opacity = c.alpha / g.opacity.data[i];
        }
        const auto put = [&](float* to, float x) { *to = add ? *to + x : x; };
        for (int k = 0; k < 3; ++k) put(out.mean.data + 3 * Index(i) + k, d.mean[k]);
        for (int k = 0; k < 4; ++k) put(out.rotation.data + 4 * Index(i) + k, d.rotation[k]);
        for (int k = 0; k < 3; ++k) put(out.scale.data + 3 * Index(i) + k, d.scale[k]);
        put(out.opacity.data + i, opacity);
    }
};

/// First step of the background's gradient: sums over pixels in fixed chunks, a channel a block of
/// them at a time.
struct BackgroundKernel {
    static constexpr const char* name = "gradient of the background";
    static constexpr int threads = 128, blocks = 8;
    static constexpr Index chunk = 4096; ///< pixels
    /// Shared memory of a block.
    struct Shared {
        float sum[threads];
    };
    DeviceColumns<const float> g_feature, alpha;
    float* partial; ///< channels x chunks

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const Index begin = block.index() * chunk, end = rye::min(begin + chunk, g_feature.cols);
        for (Index c = 0; c < g_feature.rows; ++c) {
            block.each_thread([&](int t) {
                float s = 0;
                for (Index p = begin + t; p < end; p += threads)
                    s += g_feature.data[p * g_feature.rows + c] * (1.0F - alpha.data[p]);
                shared.sum[t] = s;
            });
            for (int apart = threads / 2; apart > 0; apart /= 2)
                block.each_thread([&](int t) {
                    if (t < apart) shared.sum[t] += shared.sum[t + apart];
                });
            block.each_thread([&](int t) {
                if (t == 0) partial[block.index() * g_feature.rows + c] = shared.sum[0];
            });
        }
    }
};
/// Second step of the background's gradient: sums over chunks, in their order.
struct BackgroundSumKernel {
    static constexpr const char* name = "gradient of the background";
    static constexpr int threads = 128, blocks = 1;
    struct Shared {};
    const float* partial;
    Index channels, chunks;
    float* out;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            for (Index c = t; c < channels; c += threads) {
                float s = 0;
                for (Index k = 0; k < chunks; ++k) s += partial[k * channels + c];
                out[c] = s;
            }
        });
    }
};

} // namespace rye::detail
