// SPDX-License-Identifier: Apache-2.0
/// rye/nn/features.hpp: the VGG-16 feature extractor: five slices of 3 x 3 convolutions with ReLU,
/// with 2 x 2 max pooling between slices. Outputs: relu1_2, relu2_2, relu3_3, relu4_3,
/// relu5_3. The user supplies the weights; fields have torchvision's names, "features.0.weight"
/// and so on. Source: Simonyan and Zisserman, "Very Deep Convolutional Networks", 2015,
/// configuration D.
#pragma once

#include <array>
#include <string>
#include <tuple>
#include <vector>

#include <rye/core/error.hpp>
#include <rye/core/fields.hpp>
#include <rye/nn/convolution.hpp>

namespace rye {

/// Number of slices, each at half the size of the previous one.
inline constexpr int vgg_slices = 5;

/// Layers of the feature extractor; by default VGG16's.
struct VggShape {
    int in_channels = 3;
    std::array<int, vgg_slices> channels{64, 128, 256, 512, 512};
    std::array<int, vgg_slices> convolutions{2, 2, 3, 3, 3};
};

/// Weights of the feature extractor.
template <class T>
struct Vgg {
    VggShape shape;
    std::vector<Columns<T>> weight; ///< out x 9 in, see convolution.hpp
    std::vector<Columns<T>> bias;   ///< out x 1

    /// All weights zero.
    explicit Vgg(const VggShape& s = {}) : shape(s) {
        int in = s.in_channels;
        for (int slice = 0; slice < vgg_slices; ++slice)
            for (int k = 0; k < s.convolutions[static_cast<std::size_t>(slice)]; ++k) {
                const int out = s.channels[static_cast<std::size_t>(slice)];
                weight.push_back(Columns<T>::Zero(out, 9 * in));
                bias.push_back(Columns<T>::Zero(out, 1));
                in = out;
            }
    }

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        const VggShape s = std::get<0>(std::tie(p...)).shape;
        std::size_t layer = 0;
        int index = 0; // torchvision numbers convolutions, ReLUs and pooling layers alike
        for (const int count : s.convolutions) {
            for (int k = 0; k < count; ++k, ++layer, index += 2) {
                const std::string name = "features." + std::to_string(index);
                f(name + ".weight", p.weight[layer]...);
                f(name + ".bias", p.bias[layer]...);
            }
            ++index;
        }
    }
};

/// Outputs of all convolutions after ReLU; those that end a slice are the features.
template <class T>
struct VggTrace {
    std::vector<Image<T>> layer;
    std::array<std::size_t, vgg_slices> slice_end{}; ///< index of the layer that ends each slice

    const Image<T>& feature(int slice) const {
        return layer[slice_end[static_cast<std::size_t>(slice)]];
    }
};

namespace detail {

/// Returns the place of the largest of four numbers, 0 to 3; the first on a tie.
template <class T>
RYE_HD int largest_of_four(const T& a, const T& b, const T& c, const T& d) {
    int best = b > a ? 1 : 0;
    if (c > (best == 1 ? b : a)) best = 2;
    return d > (best == 2 ? c : best == 1 ? b : a) ? 3 : best;
}

/// The column of the largest of four pixels, the first on a tie.
template <class T>
Index largest_of_four(const Image<T>& in, Index x, Index y, Index channel) {
    const Index first = 2 * y * in.width + 2 * x, below = first + in.width;
    const int best = largest_of_four<T>(in.pixels(channel, first), in.pixels(channel, first + 1),
                                        in.pixels(channel, below), in.pixels(channel, below + 1));
    return (best < 2 ? first : below) + best % 2;
}

/// 2 x 2 max pooling; drops an odd last row or column.
template <class T, Backend B>
Image<T> max_pool(const B& backend, const Image<T>& in) {
    Image<T> out(in.width / 2, in.height / 2, in.channels());
    for_chunks(backend.threads, out.height, 8, [&](Index b, Index e, Index) {
        for (Index y = b; y < e; ++y)
            for (Index x = 0; x < out.width; ++x)
                for (Index c = 0; c < in.channels(); ++c)
                    out.pixels(c, y * out.width + x) = in.pixels(c, largest_of_four(in, x, y, c));
    });
    return out;
}

template <class T, Backend B>
Image<T> max_pool_vjp(const B& backend, const Image<T>& in, const Image<T>& g) {
    Image<T> out(in.width, in.height, in.channels());
    for_chunks(backend.threads, g.height, 8, [&](Index b, Index e, Index) {
        for (Index y = b; y < e; ++y)
            for (Index x = 0; x < g.width; ++x)
                for (Index c = 0; c < in.channels(); ++c)
                    out.pixels(c, largest_of_four(in, x, y, c)) = g.pixels(c, y * g.width + x);
    });
    return out;
}

template <class T, Backend B>
void add_bias_relu(const B& backend, Image<T>& image, const Columns<T>& bias) {
    const Index c = image.channels();
    for_chunks(backend.threads, image.size(), 1024, [&](Index b, Index e, Index) {
        for (Index j = b; j < e; ++j) {
            T* p = image.pixels.col(j).data();
            transform_array<B>(
                c, p, [](const auto& x, const auto& y) { return relu(x + y); }, p, bias.data());
        }
    });
}

} // namespace detail

/// The features of each slice of an image. Throws Error for other channels, or fewer than 16 pixels
/// a side.
template <class T, Backend B>
VggTrace<T> vgg_forward(const B& backend, const Vgg<T>& net, const Image<T>& in) {
    require(in.channels() == net.shape.in_channels && in.width >= 16 && in.height >= 16,
            "vgg_forward", "got ", in.channels(), " channels of ", in.width, " x ", in.height,
            " pixels, expected ", net.shape.in_channels, " of at least 16 x 16");
    VggTrace<T> t;
    for (std::size_t slice = 0; slice < vgg_slices; ++slice)
        for (int k = 0; k < net.shape.convolutions[slice]; ++k) {
            const std::size_t l = t.layer.size();
            const Padded<T> x = l == 0 ? padded(backend, in)
                                : k == 0
                                    ? padded(backend, detail::max_pool(backend, t.layer[l - 1]))
                                    : padded(backend, t.layer[l - 1]);
            t.layer.push_back(convolve3x3(backend, net.weight[l], x));
            detail::add_bias_relu(backend, t.layer.back(), net.bias[l]);
            t.slice_end[slice] = l;
        }
    return t;
}

/// The cotangent of the input, given those of the five features (channels x pixels each).
template <class T, Backend B>
Columns<T> vgg_vjp_input(const B& backend, const Vgg<T>& net, const VggTrace<T>& t,
                         const std::array<Columns<T>, vgg_slices>& g_features) {
    Image<T> g;
    std::size_t l = t.layer.size();
    for (std::size_t slice = vgg_slices; slice-- > 0;) {
        const Image<T>& feature = t.layer[t.slice_end[slice]];
        if (g.pixels.size() == 0) {
            g.width = feature.width;
            g.height = feature.height;
            g.pixels = g_features[slice];
        } else {
            g = detail::max_pool_vjp(backend, feature, g);
            g.pixels += g_features[slice];
        }
        for (int k = 0; k < net.shape.convolutions[slice]; ++k) {
            --l;
            const Columns<T>& y = t.layer[l].pixels;
            for_chunks(backend.threads, y.size(), 16384, [&](Index b, Index e, Index) {
                T* to = g.pixels.data() + b;
                detail::transform_array<B>(
                    e - b, to, [](const auto& v, const auto& gv) { return relu_vjp(v, gv); },
                    y.data() + b, to);
            });
            g = convolve3x3_vjp_input(backend, net.weight[l], g);
        }
    }
    return std::move(g.pixels);
}

} // namespace rye
