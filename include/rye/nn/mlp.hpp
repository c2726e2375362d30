// SPDX-License-Identifier: Apache-2.0
/// rye/nn/mlp.hpp: the multilayer perceptron over columns, with one skip, and its vjp.
/// Layer l maps dims[l] to dims[l + 1]; layer floor(len(dims) / 2), or skip_layer, also takes the
/// input again, after the hidden part. LeakyReLU(0.01), or another activation, after every layer
/// but the last; the caller applies the output activation. The last `frame_inputs` rows of the
/// input are the same for all points, so their products are added to the biases once per call, and
/// their gradients come from the summed cotangents. Points pass all layers in blocks that fit the
/// cache. Source: Xu et al., "Gaussian Head Avatar", 2024, and its published configuration.
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
#include <rye/nn/activations.hpp>
#include <rye/nn/mlp_shape.hpp>
#include <rye/nn/product.hpp>

namespace rye {

/// Weights (out x in) and biases (out x 1); gradients and moments have the same type.
template <class T, Activation A = LeakyRelu>
struct Mlp {
    using Activation = A;
    MlpShape shape;
    std::vector<Columns<T>> weight;
    std::vector<Columns<T>> bias;

    Mlp() = default;
    /// All weights and biases zero.
    explicit Mlp(const MlpShape& s) : shape(s) {
        require(s.dims.size() >= 2, "Mlp", "got ", s.dims.size(), " dims, expected at least 2");
        require(s.frame_inputs >= 0 && s.frame_inputs <= s.dims[0], "Mlp", "got ", s.frame_inputs,
                " frame inputs, expected 0 to ", s.dims[0]);
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

/// Outputs of the hidden layers of a forward pass, for the vjp. Reuse it between calls, so that its
/// memory is allocated once.
template <class T>
struct MlpTrace {
    std::vector<Columns<T>> hidden; ///< per layer but the last: dims[l + 1] x N
};

namespace detail {

/// Does nothing to columns [b, e) before or after a pass.
struct NothingAround {
    void operator()(Index, Index) const {}
};

/// Layers prepared for the forward pass: weights as left factors, biases with the products of the
/// frame inputs added, padded by a vector.
template <Backend B, class T>
struct MlpLayers {
    struct Layer {
        LeftFactor<B, T> hidden, input;
        VecX<T> bias;
        bool takes_hidden, takes_points;  ///< products that it sums
        bool last;                        ///< without LeakyReLU
    };
    std::vector<Layer> layers;

    template <class A>
    MlpLayers(const Mlp<T, A>& m, const VecX<T>& frame) {
        const MlpShape& s = m.shape;
        layers.resize(static_cast<std::size_t>(s.layers()));
        for (int l = 0; l < s.layers(); ++l) {
            const std::size_t i = static_cast<std::size_t>(l);
            const Columns<T>& w = m.weight[i];
            Layer& layer = layers[i];
            const int h = s.hidden_in(l), p = s.point_inputs();
            layer.takes_hidden = h > 0;
            layer.takes_points = s.reads_input(l) && (p > 0 || h == 0);
            layer.last = l + 1 == s.layers();
            if (layer.takes_hidden) layer.hidden.set(w.leftCols(h));
            if (layer.takes_points) layer.input.set(w.middleCols(h, p));
            layer.bias = VecX<T>::Zero(w.rows() + room);
            layer.bias.head(w.rows()) = m.bias[i].col(0);
            if (s.reads_input(l) && frame.size() > 0)
                layer.bias.head(w.rows()) += w.rightCols(s.frame_inputs) * frame;
        }
    }

  private:
    static constexpr Index room = 64;
};

/// y = W [hidden; x] + b, and the activation unless last.
template <Backend B, class A, class T>
void mlp_layer(const typename MlpLayers<B, T>::Layer& layer, const ColumnsView<T>& hidden,
               const ColumnsView<T>& x, ColumnsSpan<T> y) {
    const auto finish = [&](const auto& last) {
        const T* const bias = layer.bias.data();
        const auto activated = [&](Index row, const auto& sum) {
            const auto v = sum + load_like(sum, bias + row);
            if constexpr (std::remove_cvref_t<decltype(last)>::value)
                return v;
            else
                return A::value(v);
        };
        if (layer.takes_hidden && layer.takes_points) {
            layer.hidden.times(hidden, y, [](Index, const auto& sum, const auto&) { return sum; });
            layer.input.times(x, y, [&](Index row, const auto& sum, const auto& before) {
                return activated(row, std::remove_cvref_t<decltype(sum)>(before + sum));
            });
        } else {
            const bool first = !layer.takes_hidden;
            (first ? layer.input : layer.hidden)
                .times(first ? x : hidden, y, [&](Index row, const auto& sum, const auto&) {
                    return activated(row, sum);
                });
        }
    };
    if (layer.last)
        finish(std::true_type());
    else
        finish(std::false_type());
}

} // namespace detail

/// points: point_inputs x N, frame: frame_inputs. Sets y, outputs x N, before any output
/// activation. trace may be null. before(b, e) is called before points [b, e) are read, after(b, e)
/// when their outputs are in y, on the thread that computes them.
template <class T, class A, Backend B, class Before, class After>
void mlp_forward_around(const B& backend, const Mlp<T, A>& m,
                        const std::type_identity_t<ColumnsView<T>>& points,
                        const std::type_identity_t<VecX<T>>& frame,
                        std::type_identity_t<MlpTrace<T>>* trace, Columns<T>& y,
                        const Before& before, const After& after) {
    const MlpShape& s = m.shape;
    RYE_ASSERT(points.rows() == s.point_inputs(), "mlp_forward: points have other rows");
    RYE_ASSERT(frame.size() == s.frame_inputs, "mlp_forward: frame has another size");
    const int layers = s.layers();
    const Index n = points.cols();
    const detail::MlpLayers<B, T> packed(m, frame);
    if (trace) {
        trace->hidden.resize(static_cast<std::size_t>(layers - 1));
        for (int l = 0; l + 1 < layers; ++l)
            trace->hidden[static_cast<std::size_t>(l)].resize(s.layer_out(l), n);
    }
    y.resize(s.outputs(), n);
    for_chunks(backend.threads, n, detail::mlp_task(s, n), [&](Index b, Index e, Index) {
        before(b, e);
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
            detail::mlp_layer<B, A, T>(packed.layers[static_cast<std::size_t>(l)], hidden(l - 1), x,
                                       hidden(l));
        after(b, e);
    });
}

/// Runs mlp_forward_around with nothing around. Returns y.
template <class T, class A, Backend B>
Columns<T> mlp_forward(const B& backend, const Mlp<T, A>& m,
                       const std::type_identity_t<ColumnsView<T>>& points,
                       const std::type_identity_t<VecX<T>>& frame,
                       std::type_identity_t<MlpTrace<T>>* trace) {
    Columns<T> y;
    mlp_forward_around<T>(backend, m, points, frame, trace, y, detail::NothingAround{},
                          detail::NothingAround{});
    return y;
}

/// Inputs and trace of a forward pass.
template <class T>
struct MlpPass {
    ColumnsView<T> points;      ///< point_inputs x N
    const VecX<T>& frame;       ///< frame_inputs
    const MlpTrace<T>& trace;
};

/// Destination of gradients; a null pointer skips one.
template <class T, class A>
struct MlpGradient {
    Mlp<T, A>& params;             ///< added to
    Columns<T>* points = nullptr;  ///< overwritten, point_inputs x N
    VecX<T>* frame = nullptr;      ///< overwritten, frame_inputs
};

/// Gradients for the cotangent g_out (outputs x N) of mlp_forward's result. before(b, e) is called
/// before columns [b, e) of g_out are read, after(b, e) when those of g.points are set, on the
/// thread that computes them.
template <class T, class A, Backend B, class Before, class After>
void mlp_vjp_around(const B& backend, const Mlp<T, A>& m,
                    const std::type_identity_t<MlpPass<T>>& pass,
                    const std::type_identity_t<ColumnsView<T>>& g_out,
                    const std::type_identity_t<MlpGradient<T, A>>& g, const Before& before_piece,
                    const After& after_piece) {
    const MlpShape& s = m.shape;
    const ColumnsView<T>& points = pass.points;
    Columns<T>* const g_points = g.points;
    const int layers = s.layers(), p = s.point_inputs();
    const Index n = points.cols(), chunk = detail::mlp_chunk(n),
                piece = detail::mlp_piece(s, chunk);
    RYE_ASSERT(g_out.rows() == s.outputs() && g_out.cols() == n, "mlp_vjp: g_out differs in shape");
    if (g_points) g_points->resize(p, n);
    const detail::MlpOffsets at(s);
    const bool whole = n > 0 && n <= chunk; // one chunk adds to the gradients themselves
    Columns<T> parts(whole ? 0 : at.size, detail::chunk_count(n, chunk));
    VecX<T> total(at.size);
    std::vector<detail::LeftFactor<B, T>> to_hidden(static_cast<std::size_t>(layers)),
        to_input(to_hidden);
    for (int l = 0; l < layers; ++l) {
        const std::size_t i = static_cast<std::size_t>(l);
        const int h = s.hidden_in(l);
        if (h > 0) to_hidden[i].set_transposed(m.weight[i].leftCols(h));
        if (g_points && s.reads_input(l) && p > 0)
            to_input[i].set_transposed(m.weight[i].middleCols(h, p));
    }
    const auto added = [](Index, const auto& sum, const auto& before) { return before + sum; };
    const auto alone = [](Index, const auto& sum, const auto&) { return sum; };
    const int reads_last = s.skip() < layers ? s.skip() : 0; // the last layer that takes the input

    for_chunks(backend.threads, n, chunk, [&](Index first, Index last, Index c) {
        if (!whole) parts.col(c).setZero();
        std::vector<Columns<T>> bias;
        for (int l = 0; l < layers; ++l) bias.push_back(Columns<T>::Zero(s.layer_out(l), 1));
        Columns<T> buffers[2];
        detail::LeftFactor<B, T> g_rows;
        for (Index b = first; b < last; b += piece) {
            const Index k = std::min(piece, last - b);
            const ColumnsView<T> x = points.middleCols(b, k);
            const auto layer = [&](int l, const ColumnsView<T>& gl, Columns<T>& g_below) {
                const std::size_t i = static_cast<std::size_t>(l);
                const int h = s.hidden_in(l);
                Eigen::Map<Columns<T>> weight(
                    whole ? g.params.weight[i].data() : &parts(at.weight[i], c), s.layer_out(l),
                    s.fan_in(l));
                g_rows.set_and_sum(gl, bias[i]);
                if (s.reads_input(l) && p > 0) {
                    g_rows.times_transposed(x, weight.middleCols(h, p), added);
                    if (g_points && l == reads_last)
                        to_input[i].times(gl, g_points->middleCols(b, k), alone);
                    else if (g_points)
                        to_input[i].times(gl, g_points->middleCols(b, k), added);
                }
                if (h == 0) return;
                const ColumnsView<T> below = pass.trace.hidden[i - 1].middleCols(b, k);
                g_rows.times_transposed(below, weight.leftCols(h), added);
                g_below.resize(h, k);
                to_hidden[i].times(
                    gl, g_below,
                    [](Index, const auto& sum, const auto& y) { return A::vjp(y, sum); },
                    below);
            };
            before_piece(b, b + k);
            layer(layers - 1, g_out.middleCols(b, k), buffers[0]);
            for (int l = layers - 2, from = 0; l >= 0; --l, from = 1 - from)
                layer(l, buffers[from], buffers[1 - from]);
            after_piece(b, b + k);
        }
        T* const biases = whole ? total.data() : &parts(0, c);
        for (std::size_t i = 0; i < bias.size(); ++i) {
            Eigen::Map<VecX<T>>(biases + at.bias[i], bias[i].size()) = bias[i].col(0);
            if (whole) g.params.bias[i] += bias[i];
        }
    });

    // The parts are added in their order, all layers in one region.
    for_chunks(backend.threads, whole ? 0 : at.size, 1024, [&](Index b, Index e, Index) {
        total.segment(b, e - b).setZero();
        for (Index c = 0; c < parts.cols(); ++c)
            total.segment(b, e - b) += parts.col(c).segment(b, e - b);
        const auto add = [&](Index from, Columns<T>& to) {
            const Index low = std::max(b, from), high = std::min(e, from + to.size());
            if (low < high)
                Eigen::Map<VecX<T>>(to.data() + low - from, high - low) +=
                    total.segment(low, high - low);
        };
        for (std::size_t i = 0; i < at.weight.size(); ++i) {
            add(at.weight[i], g.params.weight[i]);
            add(at.bias[i], g.params.bias[i]);
        }
    });
    if (g.frame) g.frame->setZero(s.frame_inputs);
    for (int l = 0; l < layers; ++l) {
        const std::size_t i = static_cast<std::size_t>(l);
        if (!s.reads_input(l) || s.frame_inputs == 0) continue;
        const VecX<T> all = total.segment(at.bias[i], s.layer_out(l)); // cotangents of all points
        g.params.weight[i].rightCols(s.frame_inputs) += all * pass.frame.transpose();
        if (g.frame) *g.frame += m.weight[i].rightCols(s.frame_inputs).transpose() * all;
    }
}

/// Runs mlp_vjp_around with nothing around.
template <class T, class A, Backend B>
void mlp_vjp(const B& backend, const Mlp<T, A>& m, const std::type_identity_t<MlpPass<T>>& pass,
             const std::type_identity_t<ColumnsView<T>>& g_out,
             const std::type_identity_t<MlpGradient<T, A>>& g) {
    mlp_vjp_around<T>(backend, m, pass, g_out, g, detail::NothingAround{}, detail::NothingAround{});
}

} // namespace rye
