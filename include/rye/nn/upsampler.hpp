// SPDX-License-Identifier: Apache-2.0
/// rye/nn/upsampler.hpp: the super-resolution network, from feature maps to an image in 0..1.
/// `inc` and one `up` per doubling are pairs of 3 x 3 convolution, InstanceNorm, ReLU; an `up`
/// doubles its input first; `outc` is a 1 x 1 convolution and a sigmoid. With capacity c and d
/// doublings the widths are 2^d c, ..., 2 c, c. Source: Xu et al., "Gaussian Head Avatar", 2024.
/// Nested under the name "upsampler", the fields have the names of its checkpoints.
#pragma once

#include <cmath>
#include <string>
#include <type_traits>
#include <vector>

#include <rye/core/error.hpp>
#include <rye/core/fields.hpp>
#include <rye/core/random.hpp>
#include <rye/nn/activations.hpp>
#include <rye/nn/bilinear.hpp>
#include <rye/nn/convolution.hpp>
#include <rye/nn/instance_norm.hpp>

namespace rye {

/// Treatment of the channels' mean and variance in each block of the upsampler.
enum class Normalization {
    instance, ///< as published
    none      ///< a crop then gives the same pixels as the whole image
};

/// Layers of the upsampler.
struct UpsamplerShape {
    int in_channels = 32;
    int capacity = 32; ///< channels before the last layer
    int doublings = 2; ///< the output is 2^doublings times the input
    Normalization norm = Normalization::instance;
    /// A deviation for short training: the upsampled first three channels b, clamped to (0, 1), are
    /// the odds that outc multiplies: b e^z / (b e^z + 1 - b). This is sigmoid(z + logit b) without
    /// a logarithm, so its slope in b is 1 at z = 0 for every b. outc is initialised to zero, so
    /// training starts at the upsampled image.
    bool skip = false;

    int blocks() const { return doublings + 1; }
    int layers() const { return 2 * blocks(); }
    int block_out(int block) const { return capacity << (doublings - block); }
    int layer_in(int l) const {
        return l == 0 ? in_channels : l % 2 == 0 ? block_out(l / 2 - 1) : block_out(l / 2);
    }
};

template <class T>
struct UpsamplerTrace;

/// Gradients and moments have the same type.
template <class T>
struct Upsampler {
    using Trace = UpsamplerTrace<T>;
    UpsamplerShape shape;
    std::vector<Columns<T>> conv; ///< per layer: out x 9 in, see convolution.hpp
    Columns<T> out_weight;        ///< 3 x capacity
    Columns<T> out_bias;          ///< 3 x 1

    Upsampler() = default;
    /// All weights zero.
    explicit Upsampler(const UpsamplerShape& s)
        : shape(s),
          out_weight(Columns<T>::Zero(3, s.capacity)),
          out_bias(Columns<T>::Zero(3, 1)) {
        require(s.in_channels >= (s.skip ? 3 : 1) && s.capacity >= 1 && s.doublings >= 0,
                "Upsampler", "got ", s.in_channels, " channels, capacity ", s.capacity, ", ",
                s.doublings, " doublings, expected at least 1 channel (3 with skip), 1 and 0");
        for (int l = 0; l < s.layers(); ++l)
            conv.push_back(Columns<T>::Zero(s.block_out(l / 2), 9 * s.layer_in(l)));
    }

    /// PyTorch's default: uniform in +-1 / sqrt(fan_in).
    static Upsampler init(const UpsamplerShape& s, const Random& random) {
        Upsampler u(s);
        std::uint64_t array = 0;
        const auto fill = [&](Columns<T>& a, int fan_in) {
            const double bound = 1.0 / std::sqrt(static_cast<double>(fan_in));
            const Random r = random.fork(array++);
            for (Index i = 0; i < a.size(); ++i)
                a(i) = T(bound * (2.0 * r.uniform(static_cast<std::uint64_t>(i)) - 1.0));
        };
        for (Columns<T>& w : u.conv) fill(w, static_cast<int>(w.cols()));
        if (!s.skip) {
            fill(u.out_weight, s.capacity);
            fill(u.out_bias, s.capacity);
        }
        return u;
    }

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        const std::size_t n = std::get<0>(std::tie(p...)).conv.size();
        for (std::size_t l = 0; l < n; ++l) {
            const std::string block = l < 2 ? "inc" : "up" + std::to_string(l / 2) + ".conv";
            f(block + ".double_conv." + (l % 2 == 0 ? "0" : "3") + ".weight", p.conv[l]...);
        }
        f("outc.conv.weight", p.out_weight...);
        f("outc.conv.bias", p.out_bias...);
    }
};

/// Intermediate values of a forward pass, for the vjp. Reuse it between calls.
template <class T>
struct UpsamplerTrace {
    std::vector<Image<T>> normal; ///< per layer: normalised, before ReLU
    std::vector<VecX<T>> gain;    ///< per layer: 1 / sqrt(variance + eps) of the normalisation
    Image<T> base;                ///< the upsampled first three channels, if skip
    Image<T> out;
};

namespace detail {

/// The padded input of layer l: the image, or the output of the layer below, upsampled at the start
/// of a block. Recomputed in the vjp, which is cheaper than storing it.
template <class T, Backend B>
Padded<T> upsampler_layer_input(const B& backend, const Image<T>& in,
                                const std::vector<Image<T>>& normal, int l) {
    if (l == 0) return padded(backend, in);
    const Image<T>& below = normal[static_cast<std::size_t>(l - 1)];
    const auto f = [](const auto& x) { return relu(x); };
    if (l % 2 == 1) return padded(backend, below, f);
    const Index w = 2 * below.width, h = 2 * below.height, c = below.channels();
    Padded<T> out{static_cast<int>(w), static_cast<int>(h), Columns<T>::Zero(c, (w + 2) * (h + 2))};
    double_into(backend, below, f,
                [&](Index y) { return out.pixels.col((y + 1) * (w + 2) + 1).data(); });
    return out;
}

/// Pixels per partial sum of the last layer's gradients: at most 16 chunks.
inline Index outc_grain(Index pixels) { return std::max<Index>(2048, chunk_count(pixels, 16)); }

/// Pixels per chunk of the last layer.
inline constexpr Index last_layer_grain = 2048;

/// Inputs of the last layer.
template <class T>
struct LastLayerInput {
    const Image<T>& below;  ///< output of the layer below
    const Image<T>& base;   ///< the upsampled first three channels, with skip
};

/// Pixels [b, e) of the output, one chunk.
template <Backend B, class T>
void last_layer(const Upsampler<T>& u, const LastLayerInput<T>& in, Index b, Index e,
                Image<T>& out) {
    const Columns<T> h =
        in.below.pixels.middleCols(b, e - b).unaryExpr([](const T& x) { return relu(x); });
    Columns<T> z = u.out_weight * h;
    z.colwise() += u.out_bias.col(0);
    T* to = out.pixels.col(b).data();
    if (u.shape.skip)
        transform_array<B>(
            z.size(), to,
            [](const auto& low, const auto& x) { return odds_sigmoid(clamped_base(low), x); },
            in.base.pixels.col(b).data(), z.data());
    else
        transform_array<B>(
            z.size(), to, [](const auto& x) { return sigmoid(x); }, z.data());
}

} // namespace detail

/// in: in_channels. Returns 3 channels in 0..1, 2^doublings times as wide and high. trace may be
/// null.
template <class T, Backend B>
Image<T> upsampler_forward(const B& backend, const Upsampler<T>& u, const Image<T>& in,
                           std::type_identity_t<UpsamplerTrace<T>>* trace) {
    const UpsamplerShape& s = u.shape;
    RYE_ASSERT(in.channels() == s.in_channels, "upsampler_forward: in has other channels");
    UpsamplerTrace<T> local;
    UpsamplerTrace<T>& t = trace ? *trace : local;
    t.normal.resize(static_cast<std::size_t>(s.layers()));
    t.gain.resize(static_cast<std::size_t>(s.layers()));
    for (int l = 0; l < s.layers(); ++l) {
        const std::size_t i = static_cast<std::size_t>(l);
        t.normal[i] = convolve3x3(backend, u.conv[i],
                                  detail::upsampler_layer_input(backend, in, t.normal, l));
        if (s.norm == Normalization::instance)
            t.gain[i] = instance_norm(backend, t.normal[i].pixels);
        if (!trace && l > 0) t.normal[i - 1] = {};
    }
    if (s.skip) {
        t.base = {};
        t.base.width = in.width;
        t.base.height = in.height;
        t.base.pixels.resize(3, in.size());
        for_chunks(backend.threads, in.size(), detail::last_layer_grain,
                   [&](Index b, Index e, Index) {
                       for (Index j = b; j < e; ++j)
                           for (Index i = 0; i < 3; ++i) t.base.pixels(i, j) = in.pixels(i, j);
                   });
        for (int d = 0; d < s.doublings; ++d) t.base = doubled(backend, t.base);
    }
    const Image<T>& last = t.normal.back();
    Image<T> out(last.width, last.height, 3);
    for_chunks(backend.threads, out.size(), detail::last_layer_grain,
               [&](Index b, Index e, Index) {
                   detail::last_layer<B, T>(u, {last, t.base}, b, e, out);
               });
    if (trace) t.out = out;
    return out;
}

/// Gradients for the cotangent g_out (3 x pixels) of upsampler_forward's result. Adds to g_params;
/// overwrites g_in (in_channels x pixels of the input), which may be null. A user's upsampler has
/// the same signature (rig/parts.hpp).
template <class T, Backend B>
void upsampler_vjp(const B& backend, const Upsampler<T>& u, const Image<T>& in,
                   const UpsamplerTrace<T>& t, const std::type_identity_t<ColumnsView<T>>& g_out,
                   Upsampler<T>& g_params, std::type_identity_t<Columns<T>>* g_in) {
    const UpsamplerShape& s = u.shape;
    const Image<T>& last = t.normal.back();
    const Index pixels = last.size();
    RYE_ASSERT(g_out.rows() == 3 && g_out.cols() == pixels, "upsampler_vjp: g_out is not 3 x P");
    // With or without skip, d out / d z = out (1 - out); d out / d b is that over b (1 - b).
    Columns<T> g_z(3, pixels);
    for_chunks(backend.threads, pixels, detail::last_layer_grain, [&](Index b, Index e, Index) {
        const ColumnsView<T> from = g_out.middleCols(b, e - b);
        for (Index j = b; j < e; ++j)
            for (Index i = 0; i < 3; ++i) {
                const T o = t.out.pixels(i, j);
                g_z(i, j) = from(i, j - b) * (o * (T(1) - o));
            }
    });

    Image<T> g{last.width, last.height, 0};
    g.pixels.resize(s.capacity, pixels);
    const Columns<T> zero = Columns<T>::Zero(3, s.capacity + 1);
    const Columns<T> g_outc = sum_chunks(
        backend.threads, pixels, detail::outc_grain(pixels), zero, [&](Index b, Index e) {
            const Columns<T> h =
                last.pixels.middleCols(b, e - b).unaryExpr([](const T& x) { return relu(x); });
            const ColumnsView<T> gz = g_z.middleCols(b, e - b);
            g.pixels.middleCols(b, e - b).noalias() = u.out_weight.transpose() * gz;
            Columns<T> part(3, s.capacity + 1);
            part << gz * h.transpose(), gz.rowwise().sum();
            return part;
        });
    g_params.out_weight += g_outc.leftCols(s.capacity);
    g_params.out_bias += g_outc.rightCols(1);

    const auto through_relu = [](const auto& gv, const auto& v) { return relu_vjp(v, gv); };
    for (int l = s.layers() - 1; l >= 0; --l) {
        const std::size_t i = static_cast<std::size_t>(l);
        const Image<T>& y = t.normal[i];
        Padded<T> g_layer;
        if (s.norm == Normalization::instance) {
            for_chunks(backend.threads, g.pixels.size(), 16384, [&](Index b, Index e, Index) {
                T* to = g.pixels.data() + b;
                detail::transform_array<B>(e - b, to, through_relu, to, y.pixels.data() + b);
            });
            instance_norm_vjp(backend, y.pixels, t.gain[i], g.pixels);
            g_layer = padded(backend, g);
        } else {
            g_layer = padded(backend, g, through_relu, y);
        }
        convolve3x3_vjp_weight(backend, detail::upsampler_layer_input(backend, in, t.normal, l),
                               g_layer, g_params.conv[i]);
        if (l == 0 && !g_in) return;
        g = convolve3x3_vjp_input(backend, u.conv[i], g_layer);
        if (l > 0 && l % 2 == 0) g = doubled_vjp(backend, g);
    }
    *g_in = std::move(g.pixels);
    if (!s.skip) return;
    Image<T> g_base{last.width, last.height, 0};
    g_base.pixels.resize(3, pixels);
    for_chunks(backend.threads, 3 * pixels, 3 * detail::last_layer_grain,
               [&](Index b, Index e, Index) {
                   for (Index i = b; i < e; ++i)
                       g_base.pixels(i) = detail::clamped_base_vjp<T>(t.base.pixels(i), g_z(i));
               });
    for (int d = 0; d < s.doublings; ++d) g_base = doubled_vjp(backend, g_base);
    for_chunks(backend.threads, g_base.size(), detail::last_layer_grain,
               [&](Index b, Index e, Index) {
                   for (Index j = b; j < e; ++j)
                       for (Index i = 0; i < 3; ++i) (*g_in)(i, j) += g_base.pixels(i, j);
               });
}

} // namespace rye
