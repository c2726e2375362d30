// SPDX-License-Identifier: Apache-2.0
/// rye/nn/mlp.hpp: the multilayer perceptron over columns, with one skip and its vjp.
/// Layer l maps dims[l] to dims[l + 1]; layer floor(len(dims) / 2) also reads the input again,
/// after the hidden part. LeakyReLU(0.01) after every layer but the last; the caller applies what
/// follows. The last `frame_inputs` rows of the input are the same for all points, so their
/// products are folded into the biases once per call, and their gradients come from the summed
/// cotangents. Points go through all layers in blocks that stay in the cache. Source: Xu et al.,
/// "Gaussian Head Avatar", 2024, and its published configuration.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>
#include <tuple>
#include <type_traits>
#include <vector>

#include <rye/backend/backend.hpp>
#include <rye/core/error.hpp>
#include <rye/core/fields.hpp>
#include <rye/core/random.hpp>
#include <rye/nn/elementwise.hpp>

namespace rye {

struct MlpShape {
    std::vector<int> dims; ///< sizes of the input, the hidden layers and the output
    int frame_inputs = 0;  ///< how many of the last dims[0] inputs all points share

    int layers() const { return static_cast<int>(dims.size()) - 1; }
    int skip() const { return static_cast<int>(dims.size()) / 2; }
    int inputs() const { return dims.front(); }
    int outputs() const { return dims.back(); }
    int point_inputs() const { return dims.front() - frame_inputs; }
    int layer_out(int l) const { return dims[static_cast<std::size_t>(l) + 1]; }
    /// Width of the hidden part of a layer's input: none of the first layer's.
    int hidden_in(int l) const { return l == 0 ? 0 : dims[static_cast<std::size_t>(l)]; }
    bool reads_input(int l) const { return l == 0 || l == skip(); }
    int fan_in(int l) const { return hidden_in(l) + (reads_input(l) ? inputs() : 0); }
};

/// Weights (out x in) and biases (out x 1); gradients and moments have the same type.
template <class T>
struct Mlp {
    MlpShape shape;
    std::vector<Columns<T>> weight;
    std::vector<Columns<T>> bias;

    Mlp() = default;
    /// All zero.
    explicit Mlp(const MlpShape& s) : shape(s) {
        require(s.dims.size() >= 2, "Mlp",
                "got " + std::to_string(s.dims.size()) + " dims, expected at least 2");
        require(s.frame_inputs >= 0 && s.frame_inputs <= s.dims[0], "Mlp",
                "got " + std::to_string(s.frame_inputs) + " frame inputs, expected 0 to " +
                    std::to_string(s.dims[0]));
        for (int l = 0; l < s.layers(); ++l) {
            weight.push_back(Columns<T>::Zero(s.layer_out(l), s.fan_in(l)));
            bias.push_back(Columns<T>::Zero(s.layer_out(l), 1));
        }
    }

    /// PyTorch's default: weights and biases uniform in +-1 / sqrt(fan_in).
    static Mlp init(const MlpShape& s, const Random& random) {
        Mlp m(s);
        std::uint64_t array = 0;
        int layer = 0;
        fields(
            [&](const std::string&, Columns<T>& a) {
                const double bound = 1.0 / std::sqrt(static_cast<double>(s.fan_in(layer)));
                const Random r = random.fork(array);
                for (Index i = 0; i < a.size(); ++i)
                    a(i) = T(bound * (2.0 * r.uniform(static_cast<std::uint64_t>(i)) - 1.0));
                layer = static_cast<int>(++array / 2);
            },
            m);
        return m;
    }

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        const std::size_t n = std::get<0>(std::tie(p...)).weight.size();
        for (std::size_t l = 0; l < n; ++l) {
            const std::string layer = "conv" + std::to_string(l);
            f(layer + ".weight", p.weight[l]...);
            f(layer + ".bias", p.bias[l]...);
        }
    }
};

/// What the vjp needs of a forward pass: the outputs of the hidden layers. Keep it between calls,
/// so that its memory is allocated once.
template <class T>
struct MlpTrace {
    std::vector<Columns<T>> hidden; ///< of each layer but the last: dims[l + 1] x N
};

namespace detail {

/// Points that go through all layers together: about 128 KiB of the widest layer.
inline Index mlp_block(const MlpShape& s) {
    const int widest = *std::max_element(s.dims.begin(), s.dims.end());
    return std::clamp<Index>(32768 / std::max(widest, 1) / 16 * 16, 64, 512);
}

/// Points per partial sum of weight gradients: whole blocks, at most 16 chunks in all.
inline Index mlp_chunk(const MlpShape& s, Index points) {
    const Index block = mlp_block(s);
    return block * std::max<Index>(1, chunk_count(chunk_count(points, 16), block));
}

/// The biases with the products of the frame inputs folded in.
template <class T>
std::vector<VecX<T>> folded_biases(const Mlp<T>& m, const VecX<T>& frame) {
    std::vector<VecX<T>> b;
    for (int l = 0; l < m.shape.layers(); ++l) {
        const std::size_t i = static_cast<std::size_t>(l);
        b.push_back(m.bias[i].col(0));
        if (m.shape.reads_input(l) && frame.size() > 0)
            b.back() += m.weight[i].rightCols(m.shape.frame_inputs) * frame;
    }
    return b;
}

/// y = W [hidden; x] + b, and LeakyReLU unless last.
template <Backend B, class T>
void mlp_layer(const Mlp<T>& m, int l, const VecX<T>& bias, const ColumnsView<T>& hidden,
               const ColumnsView<T>& x, ColumnsSpan<T> y) {
    const Columns<T>& w = m.weight[static_cast<std::size_t>(l)];
    const int h = m.shape.hidden_in(l), p = m.shape.point_inputs();
    if (h > 0) {
        y.noalias() = w.leftCols(h) * hidden;
        if (m.shape.reads_input(l) && p > 0) y.noalias() += w.middleCols(h, p) * x;
    } else {
        y.noalias() = w.leftCols(p) * x;
    }
    const bool last = l + 1 == m.shape.layers();
    for (Index j = 0; j < y.cols(); ++j) {
        T* to = y.col(j).data();
        if (last)
            transform_array<B>(
                y.rows(), to, [](auto v, auto b) { return v + b; }, to, bias.data());
        else
            transform_array<B>(
                y.rows(), to, [](auto v, auto b) { return leaky_relu(v + b); }, to, bias.data());
    }
}

} // namespace detail

/// points: point_inputs x N, frame: frame_inputs. Returns outputs x N, without a last activation.
/// The trace may be null.
template <Backend B, class T>
Columns<T> mlp_forward(const Mlp<T>& m, const std::type_identity_t<ColumnsView<T>>& points,
                       const std::type_identity_t<VecX<T>>& frame,
                       std::type_identity_t<MlpTrace<T>>* trace) {
    const MlpShape& s = m.shape;
    RYE_ASSERT(points.rows() == s.point_inputs(), "mlp_forward: rows of points");
    RYE_ASSERT(frame.size() == s.frame_inputs, "mlp_forward: size of frame");
    const int layers = s.layers();
    const Index n = points.cols();
    const std::vector<VecX<T>> bias = detail::folded_biases(m, frame);
    if (trace) {
        trace->hidden.resize(static_cast<std::size_t>(layers - 1));
        for (int l = 0; l + 1 < layers; ++l)
            trace->hidden[static_cast<std::size_t>(l)].resize(s.layer_out(l), n);
    }
    Columns<T> y(s.outputs(), n);
    for_chunks<typename B::threads>(n, detail::mlp_block(s), [&](Index b, Index e, Index) {
        std::vector<Columns<T>> local(trace ? 0 : 2);
        const ColumnsView<T> x = points.middleCols(b, e - b);
        Columns<T> none;
        const auto hidden = [&](int l) -> ColumnsSpan<T> { // the output of layer l
            if (l < 0) return none;
            if (l + 1 == layers) return y.middleCols(b, e - b);
            if (trace) return trace->hidden[static_cast<std::size_t>(l)].middleCols(b, e - b);
            Columns<T>& buffer = local[static_cast<std::size_t>(l % 2)];
            buffer.resize(s.layer_out(l), e - b);
            return buffer;
        };
        for (int l = 0; l < layers; ++l)
            detail::mlp_layer<B, T>(m, l, bias[static_cast<std::size_t>(l)], hidden(l - 1), x,
                                    hidden(l));
    });
    return y;
}

/// Adds to g_params; overwrites g_points (point_inputs x N) and g_frame, each of which may be null.
template <Backend B, class T>
void mlp_vjp(const Mlp<T>& m, const std::type_identity_t<ColumnsView<T>>& points,
             const std::type_identity_t<VecX<T>>& frame, const MlpTrace<T>& trace,
             const std::type_identity_t<ColumnsView<T>>& g_out, Mlp<T>& g_params,
             std::type_identity_t<Columns<T>>* g_points, std::type_identity_t<VecX<T>>* g_frame) {
    const MlpShape& s = m.shape;
    const int layers = s.layers(), p = s.point_inputs();
    const Index n = points.cols(), block = detail::mlp_block(s), chunk = detail::mlp_chunk(s, n);
    RYE_ASSERT(g_out.rows() == s.outputs() && g_out.cols() == n, "mlp_vjp: shape of g_out");
    if (g_points) g_points->resize(p, n);
    std::vector<Mlp<T>> parts(static_cast<std::size_t>(chunk_count(n, chunk)));

    for_chunks<typename B::threads>(n, chunk, [&](Index first, Index last, Index c) {
        Mlp<T>& part = parts[static_cast<std::size_t>(c)] = Mlp<T>(s);
        Columns<T> g, g_below;
        for (Index b = first; b < last; b += block) {
            const Index k = std::min(block, last - b);
            const ColumnsView<T> x = points.middleCols(b, k);
            g = g_out.middleCols(b, k);
            if (g_points) g_points->middleCols(b, k).setZero();
            for (int l = layers - 1; l >= 0; --l) {
                const std::size_t i = static_cast<std::size_t>(l);
                const Columns<T>& w = m.weight[i];
                const int h = s.hidden_in(l);
                part.bias[i] += g.rowwise().sum();
                if (s.reads_input(l) && p > 0) {
                    part.weight[i].middleCols(h, p).noalias() += g * x.transpose();
                    if (g_points)
                        g_points->middleCols(b, k).noalias() += w.middleCols(h, p).transpose() * g;
                }
                if (h == 0) continue;
                const ColumnsView<T> below = trace.hidden[i - 1].middleCols(b, k);
                part.weight[i].leftCols(h).noalias() += g * below.transpose();
                g_below.resize(h, k);
                g_below.noalias() = w.leftCols(h).transpose() * g;
                transform_array<B>(
                    g_below.size(), g_below.data(),
                    [](auto y, auto gy) { return leaky_relu_vjp(y, gy); }, below.data(),
                    g_below.data());
                g.swap(g_below);
            }
        }
    });

    if (g_frame) g_frame->setZero(s.frame_inputs);
    for (int l = 0; l < layers; ++l) {
        const std::size_t i = static_cast<std::size_t>(l);
        for_chunks<typename B::threads>(m.weight[i].cols(), 16, [&](Index b, Index e, Index) {
            for (const Mlp<T>& part : parts)
                g_params.weight[i].middleCols(b, e - b) += part.weight[i].middleCols(b, e - b);
        });
        VecX<T> sum = VecX<T>::Zero(s.layer_out(l)); // of the cotangents of all points
        for (const Mlp<T>& part : parts) sum += part.bias[i].col(0);
        g_params.bias[i] += sum;
        if (s.reads_input(l) && s.frame_inputs > 0) {
            g_params.weight[i].rightCols(s.frame_inputs) += sum * frame.transpose();
            if (g_frame) *g_frame += m.weight[i].rightCols(s.frame_inputs).transpose() * sum;
        }
    }
}

} // namespace rye
