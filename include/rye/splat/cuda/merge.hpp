// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/merge.hpp: gradients of Gaussians from their slots, in the order of tiles, and back
/// through the projection; and that of the background.
#pragma once

#include <rye/splat/cuda/lists.hpp>

namespace rye {

/// C: of the layout. Channels [first, first + channels) of the features' gradient are written; with
/// `add`, those of shape and opacity are added to what is there.
template <class A, class D, int C>
struct MergeKernel {
    using Layout = ChannelLayout<C>;
    static constexpr const char* name = "merge of gradients";
    static constexpr int threads = 128, blocks = 4;
    struct Shared {
        alignas(16) float sum[threads][8];
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
        constexpr int quads = Layout::stride / 4;
        const auto base = static_cast<std::uint32_t>(block.index()) * threads;
        if (memory.report->overflow != 0) return;
        block.each_thread([&](int t) {
            for (int k = t; k < threads * quads; k += threads) {
                const std::uint32_t i = base + static_cast<std::uint32_t>(k / quads);
                if (i < memory.count) slots(shared, i, k / quads, k % quads);
            }
        });
        block.each_thread([&](int t) {
            const std::uint32_t i = base + static_cast<std::uint32_t>(t);
            if (i < memory.count) pull_back(shared.sum[t], i);
        });
    }

  private:
    RYE_DEVICE void slots(Shared& shared, std::uint32_t i, int row, int quad) const {
        constexpr int quads = Layout::stride / 4;
        const auto* const partial = reinterpret_cast<const Quad4*>(memory.partial);
        Quad4 sum{0, 0, 0, 0};
        const std::uint32_t n = memory.places[i];
        const std::size_t first = n > 0 ? memory.first[i] : 0U;
        // Four places at a time: their loads are under way together.
        constexpr int at_once = 4;
        const auto* const touched = reinterpret_cast<const std::uint32_t*>(memory.touched);
        for (std::uint32_t k = 0; k < n; k += at_once) {
            std::uint32_t flags[at_once];
            std::uint32_t slot[at_once * strips];
            Quad4 p[at_once * strips];
            unrolled<at_once>([&](auto e) { flags[e] = k + e < n ? touched[first + k + e] : 0U; });
            unrolled<at_once * strips>([&](auto e) {
                const bool has = (flags[e / strips] >> (8 * (e % strips)) & 1U) != 0;
                slot[e] = has ? memory.slot[(first + k) * strips + e] : none_of;
            });
            unrolled<at_once * strips>([&](auto e) {
                p[e] = slot[e] != none_of ? partial[std::size_t(slot[e]) * quads +
                                                    static_cast<std::size_t>(quad)]
                                          : Quad4{0, 0, 0, 0};
            });
            unrolled<at_once * strips>([&](auto e) {
                sum.x += p[e].x;
                sum.y += p[e].y;
                sum.z += p[e].z;
                sum.w += p[e].w;
            });
        }
        const float numbers[4] = {sum.x, sum.y, sum.z, sum.w};
        float* const features = out.feature.data + Index(i) * out.feature.rows + first_channel;
        for (int k = 0; k < 4; ++k) {
            const int at = 4 * quad + k, c = at - Layout::head;
            if (at < 8) shared.sum[row][at] = numbers[k];
            if (c >= 0 && c < channels) features[c] = numbers[k];
        }
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

/// The gradient of the background: what reaches it. The first of two steps: pixels in fixed chunks,
/// a channel a block of them at a time.
struct BackgroundKernel {
    static constexpr const char* name = "gradient of the background";
    static constexpr int threads = 128, blocks = 8;
    static constexpr Index chunk = 4096;     ///< pixels
    struct Shared {
        float sum[threads];
    };
    DeviceColumns<const float> g_feature, alpha;
    float* partial;                          ///< channels x chunks

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
/// The second step: chunks in their order.
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

} // namespace rye
