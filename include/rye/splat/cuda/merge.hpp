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
    static constexpr int threads = 128, blocks = 7;
    static constexpr int quads = Layout::stride / 4;
    /// Number of places that a thread tests together: the blocks of a head have 4.1 places a
    /// Gaussian. Slots of many channels leave shared memory for 4.
    static constexpr int of_thread = Layout::products ? 4 : 5;
    static constexpr std::uint32_t chunk = of_thread * threads;
    /// Shared memory of a block.
    struct Shared {
        alignas(16) float sum[threads][Layout::stride];
        std::uint32_t first[threads]; ///< place of each Gaussian in the block's
        std::uint32_t found[threads];
        std::uint32_t before[chunk + 1]; ///< slots of places before each
        std::uint32_t slot[chunk * tile_strips];
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
            shared.first[t] = i < memory.count ? memory.places[i] : 0U;
            for (float& x : shared.sum[t]) x = 0;
        });
        const std::uint32_t places = block.exclusive_sums(shared.first);
        const std::size_t start = memory.block_places[block.index()];
        for (std::uint32_t at = 0; at < places; at += chunk) {
            find(block, shared, start + at, rye::min(places - at, std::uint32_t(chunk)));
            block.each_thread([&](int t) {
                for (int k = t; k < threads * quads; k += threads)
                    add_slots(shared, k / quads, k % quads, at, places);
            });
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
    /// Lists the slots of a chunk of places, in the order of places, then of strips.
    template <class Block>
    RYE_DEVICE void find(Block& block, Shared& shared, std::size_t from,
                         std::uint32_t count) const {
        const auto* const touched = reinterpret_cast<const std::uint32_t*>(memory.touched) + from;
        auto flags = block.template of_threads<Array<std::uint32_t, std::size_t(of_thread)>>();
        auto slots =
            block.template of_threads<Array<std::uint32_t, std::size_t(of_thread * tile_strips)>>();
        block.each_thread([&](int t) {
            std::uint32_t n = 0;
            repeated<of_thread>([&](auto e) {
                const std::uint32_t place = of_thread * static_cast<std::uint32_t>(t) + e;
                flags[t][e] = place < count ? touched[place] : 0U;
            });
            // All under way together, and while the block counts.
            repeated<of_thread>([&](auto e) {
                const std::uint32_t place = of_thread * static_cast<std::uint32_t>(t) + e;
                repeated<tile_strips>([&](auto s) {
                    slots[t][tile_strips * e + s] =
                        (flags[t][e] >> (8 * s) & 1U) != 0
                            ? memory.slot[(from + place) * tile_strips + s]
                            : 0U;
                });
            });
            repeated<of_thread>(
                [&](auto e) { n += static_cast<std::uint32_t>(Block::bits_set(flags[t][e])); });
            shared.found[t] = n;
        });
        const std::uint32_t total = block.exclusive_sums(shared.found);
        block.each_thread([&](int t) {
            std::uint32_t at = shared.found[t];
            repeated<of_thread>([&](auto e) {
                const std::uint32_t place = of_thread * static_cast<std::uint32_t>(t) + e;
                shared.before[place] = at;
                repeated<tile_strips>([&](auto s) {
                    if ((flags[t][e] >> (8 * s) & 1U) != 0)
                        shared.slot[at++] = slots[t][tile_strips * e + s];
                });
            });
            if (t == 0) shared.before[chunk] = total;
        });
    }

    /// Adds four numbers of a Gaussian's slots among those found: of places from `at` on.
    RYE_DEVICE void add_slots(Shared& shared, int own, int quad, std::uint32_t at,
                              std::uint32_t places) const {
        const auto* const partial = reinterpret_cast<const Quad4*>(memory.partial);
        const std::uint32_t begin = rye::max(shared.first[own], at);
        const std::uint32_t end =
            rye::min(own + 1 < threads ? shared.first[own + 1] : places, at + chunk);
        if (begin >= end) return;
        auto* const to = reinterpret_cast<Quad4*>(shared.sum[own]) + quad;
        Quad4 sum = *to;
        const std::uint32_t last = shared.before[end - at];
        // A few at a time: their loads are under way together.
        constexpr int at_once = 4;
        for (std::uint32_t k = shared.before[begin - at]; k < last; k += at_once) {
            Quad4 p[at_once];
            repeated<at_once>([&](auto e) {
                p[e] = k + e < last ? partial[std::size_t(shared.slot[k + e]) * quads +
                                              static_cast<std::size_t>(quad)]
                                    : Quad4{0, 0, 0, 0};
            });
            repeated<at_once>([&](auto e) {
                sum.x += p[e].x;
                sum.y += p[e].y;
                sum.z += p[e].z;
                sum.w += p[e].w;
            });
        }
        *to = sum;
    }

    RYE_DEVICE void pull_back(const float* sum, std::uint32_t i) const {
        Shape<float> d{Vec3<float>(0, 0, 0), Quat<float>(0, 0, 0, 0), Vec3<float>(0, 0, 0)};
        float opacity = 0;
        if (memory.places[i] > 0) {
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
