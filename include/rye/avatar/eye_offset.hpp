// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/eye_offset.hpp: where expression and head pose move the eyeballs' centres, by one
/// network a frame. Canonical units. Source: paper eq. (10).
#pragma once

#include <rye/avatar/drivers.hpp>
#include <rye/avatar/field.hpp>
#include <rye/core/fields.hpp>

namespace rye {

/// D_e: the displacement of both eyeball centres by expression and head pose, canonical units.
template <class T, NetworkPolicy N = PublishedNetworks>
struct EyeOffsetNetwork {
    using Network = Mlp<T, typename N::Activation>;
    Network mlp;

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        detail::nested_fields<Network>("eye_offset_mlp", f, p.mlp...);
    }
    /// The last layer starts at 0, so that training starts at the measured neutral centres.
    static EyeOffsetNetwork init(const AvatarConfig& c, const Random& random) {
        const MlpShape shape = detail::network_shape<N>(
            mlp_shape(c.expression + c.pose_code<N>(), 0, c.networks.eye_offset, 6));
        EyeOffsetNetwork offset{Network::init(shape, random)};
        offset.mlp.weight.back().setZero();
        offset.mlp.bias.back().setZero();
        return offset;
    }
};

/// Intermediate results of the eyes' offset network for its vjp.
template <class T>
struct EyeOffsetTrace {
    Columns<T> input;    ///< [expression; pose code], one column
    Columns<T> squashed; ///< tanh of the output, 6 x 1
    MlpTrace<T> mlp;
};

/// 3 x 2: the displacement of the left and the right centre.
template <class T, class N, EffectSet E, Backend B>
Columns<T> eye_offset(const B& backend, const EyeOffsetNetwork<T, N>& offset,
                      const AvatarConfig& config, const FrameCode<T, E>& code,
                      EyeOffsetTrace<T>& trace) {
    trace.input.resize(code.expression.size() + code.pose.size(), 1);
    trace.input << code.expression, code.pose;
    trace.squashed = mlp_forward<T>(backend, offset.mlp, trace.input, VecX<T>(), &trace.mlp);
    detail::squash_in_place(Squash::tanh, trace.squashed);
    return T(config.deform_scale) * trace.squashed.reshaped(3, 2);
}

namespace detail {

/// An evaluation of the network.
template <class T>
struct EyeOffsetPass {
    const AvatarConfig& config;
    const EyeOffsetTrace<T>& trace;
};

/// Destinations of eye_offset_vjp.
template <class T, NetworkPolicy N>
struct EyeOffsetGradients {
    EyeOffsetNetwork<T, N>& network;
    VecX<T>& pose_code;
};

} // namespace detail

/// Adds the gradients of the network and of the pose code, given that of both offsets (3 x 2).
template <class T, class N, Backend B>
void eye_offset_vjp(const B& backend, const EyeOffsetNetwork<T, N>& offset,
                    const std::type_identity_t<detail::EyeOffsetPass<T>>& pass,
                    const Columns<T>& g_offset,
                    const std::type_identity_t<detail::EyeOffsetGradients<T, N>>& gradients) {
    const EyeOffsetTrace<T>& trace = pass.trace;
    VecX<T>& g_pose_code = gradients.pose_code;
    Columns<T> g = T(pass.config.deform_scale) * g_offset.reshaped(6, 1);
    detail::squash_vjp(Squash::tanh, trace.squashed, g);
    Columns<T> g_input;
    mlp_vjp<T>(backend, offset.mlp, {trace.input, VecX<T>(), trace.mlp}, g,
               {.params = gradients.network.mlp, .points = &g_input});
    g_pose_code += g_input.bottomRows(g_pose_code.size());
}

} // namespace rye
