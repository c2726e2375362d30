// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/field.hpp: a network weighted by an influence, run only where the influence is not 0:
///     out += gain * lambda(x) * squash(MLP([input(x), frame code])).
/// Source: paper eq. (3), (5), (6) and the same for the gaze; the terms of Phi_f.
#pragma once

#include <algorithm>
#include <cmath>
#include <type_traits>
#include <vector>

#include <rye/nn/activations.hpp>
#include <rye/nn/mlp.hpp>

namespace rye {

/// A network with what its outputs go through.
template <class T, class A = LeakyRelu>
struct Field {
    const Mlp<T, A>& mlp;
    Squash squash;
    T gain;
};
template <class T, class A>
Field(const Mlp<T, A>&, Squash, const T&) -> Field<T, A>;

namespace detail {

/// Inputs of a field.
template <class T>
struct FieldInput {
    const Columns<T>& inputs; ///< of the points, D x N
    const Columns<T>& lambda; ///< their influence, 1 x N
    const VecX<T>& frame;
};

} // namespace detail

/// Intermediate results of a field for its vjp.
template <class T>
struct FieldTrace {
    std::vector<Index> set;  ///< points with lambda > 0, ascending
    Columns<T> input;        ///< inputs of those points
    Columns<T> output;       ///< squashed outputs of those points, before gain and lambda
    MlpTrace<T> mlp;
};

namespace detail {

/// squash_value of every number; Eigen has vectors of tanh, whose last bits may be others.
template <class T>
void squash_in_place(Squash squash, Columns<T>& y) {
    if (squash == Squash::tanh) y = y.array().tanh().matrix().eval();
    if (squash == Squash::sigmoid) y = y.unaryExpr([](const T& v) { return sigmoid(v); }).eval();
}

/// Turns a gradient with respect to y = squash(v) into one with respect to v.
template <class T>
void squash_vjp(Squash squash, const Columns<T>& y, Columns<T>& g) {
    if (squash == Squash::tanh)
        g = g.cwiseProduct(y.unaryExpr([](const T& v) { return tanh_slope(v); })).eval();
    if (squash == Squash::sigmoid)
        g = g.cwiseProduct(y.unaryExpr([](const T& v) { return sigmoid_slope(v); })).eval();
}

/// The same on the backend's threads, with the same bits: pieces are of whole vectors.
template <class T, Backend B>
void squash_in_place(const B& backend, Squash squash, Columns<T>& y) {
    if (backend.threads.size() == 1) return squash_in_place(squash, y);
    for_chunks(backend.threads, y.size(), 16384, [&](Index b, Index e, Index) {
        Eigen::Map<Columns<T>> all(y.data() + b, e - b, 1);
        Columns<T> piece = all;
        squash_in_place(squash, piece);
        all = piece;
    });
}
/// The same of squash_vjp.
template <class T, Backend B>
void squash_vjp(const B& backend, Squash squash, const Columns<T>& y, Columns<T>& g) {
    if (backend.threads.size() == 1) return squash_vjp(squash, y, g);
    for_chunks(backend.threads, y.size(), 16384, [&](Index b, Index e, Index) {
        Eigen::Map<Columns<T>> all(g.data() + b, e - b, 1);
        const Columns<T> values = Eigen::Map<const Columns<T>>(y.data() + b, e - b, 1);
        Columns<T> piece = all;
        squash_vjp(squash, values, piece);
        all = piece;
    });
}

/// Points with an influence, ascending.
template <class T, Backend B>
std::vector<Index> influenced(const B& backend, const Columns<T>& lambda) {
    constexpr Index grain = 2048;
    const Index n = lambda.cols();
    std::vector<Index> set(static_cast<std::size_t>(n));
    std::vector<Index> count(static_cast<std::size_t>(chunk_count(n, grain)));
    for_chunks(backend.threads, n, grain, [&](Index b, Index e, Index c) {
        auto at = static_cast<std::size_t>(b);
        for (Index i = b; i < e; ++i) {
            set[at] = i; // kept if the next does not overwrite it
            if (lambda(0, i) > T(0)) ++at;
        }
        count[static_cast<std::size_t>(c)] = static_cast<Index>(at) - b;
    });
    auto end = set.begin();
    for (std::size_t c = 0; c < count.size(); ++c) {
        const auto from = set.begin() + static_cast<std::ptrdiff_t>(c) * grain;
        end = from == end ? end + count[c] : std::copy_n(from, count[c], end);
    }
    set.erase(end, set.end());
    return set;
}

/// Columns [begin, end) of a field's points.
struct FieldRange {
    Index begin, end;
};

/// A range of pick_into's columns.
template <class T>
void pick_range(const Columns<T>& all, const std::vector<Index>& which, FieldRange r,
                Columns<T>& picked) {
    const Index rows = all.rows();
    for (Index k = r.begin; k < r.end; ++k)
        std::copy_n(all.data() + which[static_cast<std::size_t>(k)] * rows, rows,
                    picked.data() + k * rows);
}

/// squash_in_place of a range of columns.
template <class T>
void squash_range(Squash squash, FieldRange r, Columns<T>& y) {
    if (squash == Squash::none) return;
    Columns<T> piece = y.middleCols(r.begin, r.end - r.begin);
    squash_in_place(squash, piece);
    y.middleCols(r.begin, r.end - r.begin) = piece;
}

/// Copies the columns `which` in their order, on the backend's threads.
template <class T, Backend B>
void pick_into(const B& backend, const Columns<T>& all, const std::vector<Index>& which,
               Columns<T>& picked) {
    picked.resize(all.rows(), static_cast<Index>(which.size()));
    for_chunks(backend.threads, picked.cols(), 256, [&](Index b, Index e, Index) {
        detail::pick_range(all, which, {b, e}, picked);
    });
}

} // namespace detail

/// Squashed outputs of the network for the points of `input`.
template <class T, class A, Backend B>
Columns<T> evaluate_field(const B& backend, const Field<T, A>& field, const Columns<T>& input,
                          const VecX<T>& frame, std::type_identity_t<MlpTrace<T>>* trace) {
    Columns<T> output;
    mlp_forward_around<T>(backend, field.mlp, input, frame, trace, output, detail::NothingAround{},
                          [&](Index b, Index e) {
                              detail::squash_range(field.squash, {b, e}, output);
                          });
    return output;
}

namespace detail {

/// Outputs of a field: column k is that of point set[k].
template <class T>
struct FieldOutput {
    T gain;
    const Columns<T>& lambda;
    const std::vector<Index>& set;
    const Columns<T>& output;
};

/// A range of accumulate_field's points.
template <Backend B, class T>
void accumulate_range(const FieldOutput<T>& field, const std::vector<Index>* listed, FieldRange r,
                      Columns<T>& out) {
    const Index rows = out.rows();
    for (Index j = r.begin; j < r.end; ++j) {
        const Index k = listed != nullptr ? (*listed)[static_cast<std::size_t>(j)] : j;
        const Index i = field.set[static_cast<std::size_t>(k)];
        const T w = field.gain * field.lambda(0, i);
        transform_array<B>(
            rows, out.data() + i * rows,
            [&]<class V>(const V& sum, const V& y) { return sum + V(w) * y; },
            out.data() + i * rows, field.output.data() + k * rows);
    }
}

} // namespace detail

/// out += gain lambda output, of all columns of `output`, or of those listed.
template <class T, Backend B>
void accumulate_field(const B& backend, const std::type_identity_t<detail::FieldOutput<T>>& field,
                      const std::vector<Index>* listed, Columns<T>& out) {
    const Index n = static_cast<Index>(listed != nullptr ? listed->size() : field.set.size());
    for_chunks(backend.threads, n, 256, [&](Index b, Index e, Index) {
        detail::accumulate_range<B>(field, listed, {b, e}, out);
    });
}

/// Adds the field to `out` (rows x N).
template <class T, class A, Backend B>
void add_field(const B& backend, const Field<T, A>& field,
               const std::type_identity_t<detail::FieldInput<T>>& x, Columns<T>& out,
               FieldTrace<T>& trace) {
    trace.set = detail::influenced(backend, x.lambda);
    trace.input.resize(x.inputs.rows(), static_cast<Index>(trace.set.size()));
    const detail::FieldOutput<T> added{field.gain, x.lambda, trace.set, trace.output};
    mlp_forward_around<T>(
        backend, field.mlp, trace.input, x.frame, &trace.mlp, trace.output,
        [&](Index b, Index e) {
            detail::pick_range(x.inputs, trace.set, {b, e}, trace.input);
        },
        [&](Index b, Index e) {
            detail::squash_range(field.squash, {b, e}, trace.output);
            detail::accumulate_range<B>(added, nullptr, {b, e}, out);
        });
}

namespace detail {

/// An evaluation, as far as its vjp reads it.
template <class T>
struct FieldPass {
    const Columns<T>& lambda;
    const VecX<T>& frame;
    const FieldTrace<T>& trace;
};

/// Gradients of a field; each pointer may be null.
template <class T, class A = LeakyRelu>
struct FieldGradients {
    Mlp<T, A>* mlp = nullptr;              ///< accumulated
    Columns<T>* inputs = nullptr;       ///< D x N, accumulated
    Columns<T>* lambda = nullptr;       ///< 1 x N, accumulated
    VecX<T>* frame = nullptr;           ///< accumulated
    const Columns<T>* output = nullptr; ///< an extra cotangent of the squashed outputs (set order)
};

} // namespace detail

/// Pulls g_out (rows x N) back through add_field.
template <class T, class A, Backend B>
void field_vjp(const B& backend, const Field<T, A>& field,
               const std::type_identity_t<detail::FieldPass<T>>& pass, const Columns<T>& g_out,
               const std::type_identity_t<detail::FieldGradients<T, A>>& g) {
    const T gain = field.gain;
    const Squash squash = field.squash;
    const Columns<T>& lambda = pass.lambda;
    const FieldTrace<T>& trace = pass.trace;
    const Index n = static_cast<Index>(trace.set.size());
    if (n == 0) return;
    const Index rows = trace.output.rows();
    Columns<T> g_y(rows, n), g_input;
    const auto weighted = [&](Index b, Index e) {
        for (Index k = b; k < e; ++k) {
            const Index i = trace.set[static_cast<std::size_t>(k)];
            const T w = gain * lambda(0, i);
            const T *const y = trace.output.data() + k * rows, *const gy = g_out.data() + i * rows;
            T* const to = g_y.data() + k * rows;
            for (Index r = 0; r < rows; ++r) to[r] = w * gy[r];
            if (g.output != nullptr)
                for (Index r = 0; r < rows; ++r) to[r] += (*g.output)(r, k);
            if (g.lambda != nullptr) {
                T along(0);
                for (Index r = 0; r < rows; ++r) along += y[r] * gy[r];
                (*g.lambda)(0, i) += gain * along;
            }
        }
        if (squash == Squash::none) return;
        Columns<T> block = g_y.middleCols(b, e - b);
        detail::squash_vjp<T>(squash, trace.output.middleCols(b, e - b), block);
        g_y.middleCols(b, e - b) = block;
    };
    const auto scattered = [&](Index b, Index e) {
        if (g.inputs == nullptr) return;
        const Index inputs = g_input.rows();
        for (Index k = b; k < e; ++k) {
            T* const to = g.inputs->data() + trace.set[static_cast<std::size_t>(k)] * inputs;
            detail::transform_array<B>(
                inputs, to, [](const auto& x, const auto& y) { return x + y; }, to,
                g_input.data() + k * inputs);
        }
    };
    VecX<T> g_frame;
    mlp_vjp_around<T>(
        backend, field.mlp, {trace.input, pass.frame, trace.mlp}, g_y,
        {*g.mlp, g.inputs != nullptr ? &g_input : nullptr, g.frame != nullptr ? &g_frame : nullptr},
        weighted, scattered);
    if (g.frame != nullptr) *g.frame += g_frame;
}

} // namespace rye
