// SPDX-License-Identifier: Apache-2.0
/// rye/splat/cuda/sh_color.hpp: colours from spherical harmonics on a device, and their gradients,
/// by the formula of gaussian/sh_color.hpp. Coefficients go through shared memory, since a
/// Gaussian's own lie far from its neighbour's. If a frame is given, Gaussians that it does not
/// show are left out: their colours are 0, and so are their gradients. The order of coefficients
/// in memory is a type: that of splat files, or that of programs in PyTorch.
#pragma once

#include <rye/gaussian/sh_color.hpp>
#include <rye/splat/cuda/rasterizer.hpp>

namespace rye {

/// Inputs of colours, in device memory; `constant` and `rest` lie as an order of harmonics says.
template <class T>
struct DeviceHarmonics {
    DeviceColumns<T> mean;     ///< 3 x N
    DeviceColumns<T> constant; ///< 3 x N
    DeviceColumns<T> rest;     ///< 3 K x N: of red, of green, of blue

    template <class U>
        requires(std::same_as<U, const T> && !std::is_const_v<T>)
    operator DeviceHarmonics<U>() const { return {mean, constant, rest}; }
};

namespace detail {

/// The order of splat files: constant coefficients in an array of their own, the others of a
/// Gaussian those of red, of green, then of blue.
struct HarmonicsByColour {
    RYE_DEVICE Index constant(Index i) const { return 3 * i; }
    /// Returns where number k of the rows from Gaussian `base` on is in memory, in ascending order.
    template <int row>
    RYE_DEVICE Index memory(Index base, int k) const {
        return base * row + k;
    }
    /// Returns where it is in those rows, each of red, of green, then of blue.
    template <int row>
    RYE_DEVICE static int place(int k) {
        return k;
    }
};

} // namespace detail

/// The order of programs of PyTorch: one array of triples of red, green and blue, `bases` of each
/// Gaussian, the constant one first. `constant` and `rest` both begin where the array does.
struct HarmonicsByBasis {
    Index bases;

    RYE_DEVICE Index constant(Index i) const { return 3 * bases * i; }
    template <int row>
    RYE_DEVICE Index memory(Index base, int k) const {
        return 3 * (bases * (base + k / row) + 1) + k % row;
    }
    template <int row>
    RYE_DEVICE static int place(int k) {
        const int r = k % row;
        return k - r + r % 3 * (row / 3) + r / 3;
    }
};

namespace detail {

template <int degree>
struct ShBlock {
    static constexpr int threads = 128;
    static constexpr int row = 3 * (sh_count(degree) - 1);
    static constexpr int capacity = row > 0 ? row* threads : 1;

    /// Calls f(place in memory, place in shared memory) for the rows of a block's Gaussians.
    template <class Order, class F>
    RYE_DEVICE static void each(const Order& order, Index base, Index count, int t, const F& f) {
        const int numbers = static_cast<int>(count) * row;
        if constexpr (row > 0)
            for (int k = t; k < numbers; k += threads)
                f(order.template memory<row>(base, k), Order::template place<row>(k));
    }
    /// Copies the rows of a block's Gaussians to shared memory, those for which used(number in the
    /// block) is true. A few loads are under way together.
    template <class Order, class Used>
    RYE_DEVICE static void load(const Order& order, Index base, Index count, int t,
                                const float* from, float* to, const Used& used) {
        const int numbers = static_cast<int>(count) * row;
        if constexpr (row > 0) {
            constexpr int at_once = 9;
            for (int k = t; k < numbers; k += at_once * threads) {
                float held[at_once];
                repeated<at_once>([&](auto e) {
                    const int own = k + e * threads;
                    if (own < numbers && used(own / row))
                        held[e] = from[order.template memory<row>(base, own)];
                });
                repeated<at_once>([&](auto e) {
                    const int own = k + e * threads;
                    if (own < numbers && used(own / row))
                        to[Order::template place<row>(own)] = held[e];
                });
            }
        }
    }
};

/// Colours of Gaussians from their harmonics of one degree.
template <int degree, class Order = HarmonicsByColour>
struct ShColorKernel : detail::ShBlock<degree> {
    using Rows = detail::ShBlock<degree>;
    static constexpr const char* name = "harmonics";
    static constexpr int blocks = 8;
    /// Shared memory of a block.
    struct Shared {
        alignas(16) float rest[Rows::capacity];
    };
    Order order;
    DeviceHarmonics<const float> in;
    Vec3<float> eye;
    const std::uint32_t* places;
    float* rgb;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const Index base = Index(block.index()) * Rows::threads;
        const Index count = rye::min(Index(Rows::threads), in.mean.cols - base);
        block.each_thread([&](int t) {
            Rows::each(order, base, count, t,
                       [&](Index from, int to) { shared.rest[to] = in.rest.data[from]; });
        });
        block.each_thread([&](int t) {
            if (t >= count) return;
            const Index i = base + t;
            Vec3<float> c(0, 0, 0);
            if (places == nullptr || places[i] > 0) {
                const float* const m = in.mean.data + 3 * i;
                c = ShColor<float, degree>(Vec3<float>(m[0], m[1], m[2]), eye,
                                           in.constant.data + order.constant(i),
                                           shared.rest + t * Rows::row)
                        .rgb();
            }
            for (int k = 0; k < 3; ++k) rgb[3 * i + k] = c[k];
        });
    }
};

/// Gradients of harmonics and means, given those of the colours.
template <int degree, class Order = HarmonicsByColour>
struct ShColorVjpKernel : detail::ShBlock<degree> {
    using Rows = detail::ShBlock<degree>;
    static constexpr const char* name = "vjp of harmonics";
    static constexpr int blocks = degree > 3 ? 5 : 8;
    /// Shared memory of a block.
    struct Shared {
        alignas(16) float rest[Rows::capacity]; ///< coefficients, then their gradients
        std::uint8_t used[Rows::threads]; ///< 0 if the Gaussian's gradient is 0
    };
    Order order;
    DeviceHarmonics<const float> in;
    Vec3<float> eye;
    const std::uint32_t* places;
    const float* g_rgb;
    DeviceHarmonics<float> out;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        const Index base = Index(block.index()) * Rows::threads;
        const Index count = rye::min(Index(Rows::threads), in.mean.cols - base);
        block.each_thread([&](int t) {
            if (t >= count) return;
            const float* const g = g_rgb + 3 * (base + t);
            const bool seen = places == nullptr || places[base + t] > 0;
            shared.used[t] = seen && !(g[0] == 0.0F && g[1] == 0.0F && g[2] == 0.0F) ? 1 : 0;
        });
        block.each_thread([&](int t) {
            Rows::load(order, base, count, t, in.rest.data, shared.rest,
                       [&](int own) { return shared.used[own] != 0; });
        });
        block.each_thread([&](int t) {
            if (t < count) one(shared, base + t, t);
        });
        block.each_thread([&](int t) {
            Rows::each(order, base, count, t,
                       [&](Index to, int from) { out.rest.data[to] = shared.rest[from]; });
        });
    }

  private:
    RYE_DEVICE void one(Shared& shared, Index i, int t) const {
        float* const rest = shared.rest + t * Rows::row;
        float* const g_constant = out.constant.data + order.constant(i);
        if (shared.used[t] == 0) {
            for (int k = 0; k < Rows::row; ++k) rest[k] = 0;
            for (int k = 0; k < 3; ++k) g_constant[k] = 0;
            return;
        }
        const float* const m = in.mean.data + 3 * i;
        const ShColor<float, degree> color(Vec3<float>(m[0], m[1], m[2]), eye,
                                           in.constant.data + order.constant(i), rest);
        const float* const g = g_rgb + 3 * i;
        const Vec3<float> g_mean = color.vjp(Vec3<float>(g[0], g[1], g[2]), rest, g_constant, rest);
        for (int k = 0; k < 3; ++k) out.mean.data[3 * i + k] += g_mean[k];
    }
};

} // namespace detail

/// Puts the colours of harmonics, seen from `eye`, on the stream: 3 x N numbers.
template <int most = 4, class Device, class Order = detail::HarmonicsByColour>
void sh_colors_into(const CudaQueue& queue, const Device& device,
                    const DeviceHarmonics<const float>& in, const Vec3<float>& eye, float* rgb,
                    const detail::FrameMemory* seen = nullptr, const Order& order = {}) {
    const Index n = in.mean.cols;
    detail::with_sh_degree_up_to<most>(
        sh_degree(static_cast<int>(in.rest.rows / 3) + 1), [&](auto degree) {
            device.launch(queue, (n + 127) / 128,
                          detail::ShColorKernel<degree(), Order>{
                              {}, order, in, eye, seen != nullptr ? seen->places : nullptr, rgb});
        });
}

/// Puts the gradients on the stream: of `constant` and `rest` they are written, that of `mean` is
/// added.
template <int most = 4, class Device, class Order = detail::HarmonicsByColour>
void sh_colors_vjp_into(const CudaQueue& queue, const Device& device,
                        const DeviceHarmonics<const float>& in, const Vec3<float>& eye,
                        const float* g_rgb, const DeviceHarmonics<float>& out,
                        const detail::FrameMemory* seen = nullptr, const Order& order = {}) {
    const Index n = in.mean.cols;
    detail::with_sh_degree_up_to<most>(
        sh_degree(static_cast<int>(in.rest.rows / 3) + 1), [&](auto degree) {
            device.launch(
                queue, (n + 127) / 128,
                detail::ShColorVjpKernel<degree(), Order>{
                    {}, order, in, eye, seen != nullptr ? seen->places : nullptr, g_rgb, out});
        });
}

} // namespace rye
