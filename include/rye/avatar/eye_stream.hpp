// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/eye_stream.hpp: stage 2, the eyeball Gaussians. Their positions are the template's,
/// moved by one rigid transform an eye (eye offset, gaze, head pose) and never optimised freely;
/// colour, rotation, scale and opacity are.
/// Frame: points relative to the eyeball's centre in canonical units, iris toward +z.
/// Source: paper eq. (9)-(10); composition as in docs/deviations.md.
#pragma once

#include <array>

#include <rye/avatar/field.hpp>
#include <rye/avatar/head_pose.hpp>
#include <rye/core/fields.hpp>
#include <rye/rig/eye_transform.hpp>

namespace rye {

/// D_e: the displacement of both eyeball centres by expression and head pose, canonical units.
template <class T>
struct EyeOffset {
    Mlp<T> mlp;

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        nested_fields<Mlp<T>>("eye_offset_mlp", f, p.mlp...);
    }
    /// The last layer starts at 0, so that training starts at the measured neutral centres.
    static EyeOffset init(const AvatarConfig& c, const Random& random) {
        EyeOffset offset{Mlp<T>::init(mlp_shape(c.expression + c.pose_code(), 0,
                                                c.networks.eye_offset, 6), random)};
        offset.mlp.weight.back().setZero();
        offset.mlp.bias.back().setZero();
        return offset;
    }
};

template <class T>
struct EyeOffsetTrace {
    Columns<T> input;    ///< [expression; pose code], one column
    Columns<T> squashed; ///< tanh of the output, 6 x 1
    MlpTrace<T> mlp;
};

/// 3 x 2: the displacement of the left and the right centre.
template <Backend B, class T>
Columns<T> eye_offset(const EyeOffset<T>& offset, const AvatarConfig& config,
                      const FrameCode<T>& code, EyeOffsetTrace<T>& trace) {
    trace.input.resize(code.expression.size() + code.pose.size(), 1);
    trace.input << code.expression, code.pose;
    trace.squashed = mlp_forward<B, T>(offset.mlp, trace.input, VecX<T>(), &trace.mlp);
    squash_in_place(Squash::tanh, trace.squashed);
    return T(config.deform_scale) * trace.squashed.reshaped(3, 2);
}

template <Backend B, class T>
void eye_offset_vjp(const EyeOffset<T>& offset, const AvatarConfig& config,
                    const EyeOffsetTrace<T>& trace, const Columns<T>& g_offset,
                    EyeOffset<T>& grad, VecX<T>& g_pose_code) {
    Columns<T> g = T(config.deform_scale) * g_offset.reshaped(6, 1);
    squash_vjp(Squash::tanh, trace.squashed, g);
    Columns<T> g_input;
    mlp_vjp<B, T>(offset.mlp, trace.input, VecX<T>(), trace.mlp, g, grad.mlp, &g_input, nullptr);
    g_pose_code += g_input.bottomRows(g_pose_code.size());
}

template <class T>
struct EyeStream {
    Columns<T> feature;        ///< colour channels, free, C x 2P: left eye, then right
    Columns<T> log_scale;      ///< 3 x 2P
    Columns<T> rotation;       ///< 4 x 2P, w x y z, in the frame of the eyeball
    Columns<T> opacity_logit;  ///< 1 x 2P
    EyeOffset<T> offset;

    Columns<T> position;  ///< fixed: template points about their centre, 3 x 2P
    Columns<T> centre;    ///< fixed: neutral centres, canonical, 3 x 2
    Columns<T> spacing;   ///< fixed: distance between neighbours of the template, 1 x 2P

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        f("feature", p.feature...);
        f("scales", p.log_scale...);
        f("rotation", p.rotation...);
        f("opacity", p.opacity_logit...);
        EyeOffset<T>::fields(f, p.offset...);
    }
    template <class F, class... P>
    static void buffers(F&& f, P&&... p) {
        f("xyz", p.position...);
        f("centre", p.centre...);
        f("spacing", p.spacing...);
    }
    Index per_eye() const { return position.cols() / 2; }
};

/// Takes scales back to at most `factor` times the template's spacing, and `thickness` of that
/// along the normal, so that the eyeball keeps its shape: larger Gaussians would reach over its rim
/// and paint lids, thicker ones stand out from its surface.
template <Real T>
void bound_scales(EyeStream<T>& eyes, T factor, T thickness) {
    for (Index i = 0; i < eyes.log_scale.cols(); ++i) {
        const T most = std::log(factor * eyes.spacing(0, i)), thick = most + std::log(thickness);
        eyes.log_scale.col(i) = eyes.log_scale.col(i).cwiseMin(Vec3<T>(most, most, thick));
    }
}

template <class T>
struct EyeTrace {
    EyeOffsetTrace<T> offset;
    std::array<Quat<T>, 2> turn;  ///< rest (+z) to gaze, no torsion
};

/// Scales of both eyeballs' Gaussians in the world.
template <class T>
Columns<T> eye_scales(const EyeStream<T>& eyes, const T& head_scale) {
    return head_scale * eyes.log_scale.unaryExpr([](const T& v) {
        using std::exp;
        return T(exp(v));
    });
}

/// Means and rotations of one eyeball's Gaussians, in the columns of `g` from `begin` on. Returns
/// its rotation in the world.
template <class T>
Quat<T> place_eye(const EyeStream<T>& eyes, Index eye, const EyeDrive<T>& drive,
                  const HeadTransform<T>& head, Index begin, Gaussians<T>& g) {
    const Index n = eyes.per_eye();
    const EyeTransform<T> placed =
        eye_transform<T>(drive, {{head.rotation, head.translation}, head.scale});
    const Columns<T> points = eyes.position.middleCols(eye * n, n);
    const Columns<T> rotations = eyes.rotation.middleCols(eye * n, n);
    g.mean.middleCols(begin, n) = eye_points<T>(placed, points);
    g.rotation.middleCols(begin, n) = eye_rotations<T>(placed, rotations);
    return placed.quaternion;
}

/// The eyeballs in the world.
template <Backend B, class T>
Gaussians<T> eye_gaussians(const EyeStream<T>& eyes, const AvatarConfig& config,
                           const Drivers<T>& drivers, const HeadTransform<T>& head,
                           const FrameCode<T>& code, EyeTrace<T>& trace) {
    const Columns<T> moved = eye_offset<B, T>(eyes.offset, config, code, trace.offset);
    const Index per_eye = eyes.per_eye();
    Gaussians<T> g;
    g.feature = eyes.feature;
    g.mean.resize(3, 2 * per_eye);
    g.rotation.resize(4, 2 * per_eye);
    g.scale = eye_scales(eyes, head.scale);
    g.opacity = eyes.opacity_logit.unaryExpr([](const T& v) { return sigmoid(v); });
    for (Index eye = 0; eye < 2; ++eye) {
        const Quat<T> turned =
            place_eye<T>(eyes, eye, {eyes.centre.col(eye), moved.col(eye),
                                     drivers.gaze[static_cast<std::size_t>(eye)]},
                         head, eye * per_eye, g);
        trace.turn[static_cast<std::size_t>(eye)] =
            quat_product<T>(quat_conjugate<T>(head.quaternion), turned);
    }
    return g;
}

/// Accumulates parameter gradients from cotangents of the head-frame eyeballs, which to_world_vjp
/// gives; `world` is what eye_gaussians returned.
template <Backend B, class T>
void eye_vjp(const EyeStream<T>& eyes, const AvatarConfig& config, const HeadTransform<T>& head,
             const EyeTrace<T>& trace, const Gaussians<T>& world, const Gaussians<T>& g,
             EyeStream<T>& grad, VecX<T>& g_pose_code) {
    const Index per_eye = eyes.per_eye();
    grad.feature += g.feature;
    grad.log_scale += g.scale.cwiseProduct(world.scale) / head.scale;
    grad.opacity_logit += g.opacity.cwiseProduct(
        world.opacity.unaryExpr([](const T& a) { return T(a * (T(1) - a)); }));
    Columns<T> g_offset = Columns<T>::Zero(3, 2);
    for (Index eye = 0; eye < 2; ++eye)
        for (Index i = eye * per_eye; i < (eye + 1) * per_eye; ++i) {
            g_offset.col(eye) += g.mean.col(i);
            grad.rotation.col(i) += quat_product_vjp_right<T>(
                trace.turn[static_cast<std::size_t>(eye)], g.rotation.col(i));
        }
    eye_offset_vjp<B, T>(eyes.offset, config, trace.offset, g_offset, grad.offset, g_pose_code);
}

} // namespace rye
