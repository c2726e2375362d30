// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/hold.hpp: an avatar with fewer effects: what the effects that are left out give at
/// one frame's drivers is kept in the canonical attributes, so that the avatar looks as it did
/// there, whatever the effects that are left do.
/// The head pose has nothing to keep: without it the avatar is in the head's frame, and the camera
/// (and lights) move instead. The face without HeadShading has the colours of the head at rotation
/// 0, which no constant added to its networks' colours can change. Without Kappa the gazes that
/// drive it are optical axes. Networks of driven eyes that keep on being driven have the expression
/// and the head's rotation that are left out in their biases. ViewColor is kept as that frame's
/// camera sees it by a face without networks of frames, and eyes without shadows of lids.
#pragma once

#include <rye/avatar/two_stream.hpp>
#include <rye/rig/driven_features.hpp>

namespace rye {

/// Returns the drivers that fewer effects read.
template <EffectSet Fewer, class T, EffectSet E>
Drivers<T, Fewer> restricted(const Drivers<T, E>& all) {
    Drivers<T, Fewer> d;
    detail::copy_slot(all.expression, d.expression);
    detail::copy_slot(all.pose, d.pose);
    detail::copy_slot(all.scale, d.scale);
    detail::copy_slot(all.camera, d.camera);
    for_eyes([&]<std::size_t eye>() {
        if constexpr (eye_turns<E, eye> && eye_turns<Fewer, eye>)
            of_eye<eye>(d.gaze) = of_eye<eye>(all.gaze);
        if constexpr (pupil_moves<E, eye> && pupil_moves<Fewer, eye>)
            of_eye<eye>(d.pupil) = of_eye<eye>(all.pupil);
    });
    return d;
}

namespace detail {

/// Returns true if the effects E have this driver of the face.
template <EffectSet E>
constexpr bool drives(ExpressionField) { return has_effect<E, Expression>; }
template <EffectSet E>
constexpr bool drives(PoseField) { return has_effect<E, PoseResidual>; }
template <EffectSet E, std::size_t eye>
constexpr bool drives(GazeField<eye>) { return skin_follows<E, eye>; }

/// Inputs of a frame that keep their values.
template <class T>
struct HeldInputs {
    Index first; ///< of the frame's inputs
    VecX<T> values;
};

/// The network without these inputs, which gives what it gives where they have those values.
template <class T>
Mlp<T> with_held_inputs(const Mlp<T>& all, const HeldInputs<T>& held) {
    if (all.weight.empty()) return all;
    MlpShape shape = all.shape;
    const Index n = held.values.size(), after = shape.frame_inputs - held.first - n;
    shape.dims.front() -= static_cast<int>(n);
    shape.frame_inputs -= static_cast<int>(n);
    Mlp<T> fewer(shape);
    for (int l = 0; l < shape.layers(); ++l) {
        const auto i = static_cast<std::size_t>(l);
        const Columns<T>& w = all.weight[i];
        fewer.bias[i] = all.bias[i];
        if (!shape.reads_input(l)) {
            fewer.weight[i] = w;
            continue;
        }
        const Index before = w.cols() - after - n;
        fewer.weight[i] << w.leftCols(before), w.rightCols(after);
        fewer.bias[i] += w.middleCols(before, n) * held.values;
    }
    return fewer;
}

/// Adds the highlights of a frame to the features of both eyes.
template <class T, EffectSet E, Backend B>
void keep_highlights(const B& backend, const EyeStream<T, E>& eyes, const Vec3<T>& camera,
                     const EyeTrace<T, E>& of, Columns<T>& feature) {
    const OpticsTrace<T, E>& trace = of.optics;
    const Columns<T>& position = moved_points(eyes, of.pupils);
    for (std::size_t eye = 0; eye < 2; ++eye) {
        const Index e = static_cast<Index>(eye), first = eyes.first_point(e);
        if (trace.lights[eye].empty()) continue;
        const T* const points = position.data() + 3 * first;
        const T* const seen = trace.seen_points(eyes.optics, eye, points);
        add_highlights(backend, eyes.optics,
                       {eye, camera, trace.placed[eye], points, eyes.points_of(e)},
                       trace.lights[eye], seen, feature.rows(),
                       feature.data() + feature.rows() * first);
    }
}

/// Calls f(i, factor) for each point of both eyes, with what the frame's lids leave of its colours.
template <class T, EffectSet E, class F>
void for_lid_factors(const EyeStream<T, E>& eyes, const EyeTrace<T, E>& of, const F& f) {
    if (!eyes.has_lid_shadow()) return;
    const Columns<T>& position = moved_points(eyes, of.pupils);
    for (Index i = 0; i < position.cols(); ++i)
        f(i,
          LidShade<T>(of.lids.eye[i < eyes.points_of(0) ? 0 : 1], Vec3<T>(position.col(i))).factor);
}
/// Keeps the shadows of a frame's lids in the features of both eyes.
template <class T, EffectSet E>
void keep_lid_shadow(const EyeStream<T, E>& eyes, const EyeTrace<T, E>& of, Columns<T>& feature) {
    for_lid_factors(eyes, of, [&](Index i, const T& factor) {
        feature.col(i).template head<shaded_channels>() += (factor - T(1)) * of.lids.plain.col(i);
    });
}
/// Makes features what the frame's lids darken to them; black where they leave nothing.
template <class T, EffectSet E>
void before_lid_shadow(const EyeStream<T, E>& eyes, const EyeTrace<T, E>& of, Columns<T>& feature) {
    for_lid_factors(eyes, of, [&](Index i, const T& factor) {
        feature.col(i).template head<shaded_channels>() *= factor > T(0) ? T(T(1) / factor) : T(0);
    });
}

/// Keeps the pupils of a frame that do not move any more in the eyes' points and sizes.
template <EffectSet Fewer, class T, EffectSet E>
void keep_pupils(const EyeStream<T, E>& from, const FramePupils<T>& pupils,
                 EyeStream<T, Fewer>& to) {
    static_assert(!has_effect<Fewer, Pupil> || !has_effect<E, CornealRefraction> ||
                      has_effect<Fewer, CornealRefraction>,
                  "held: a pupil moves points before they are refracted");
    for_eyes([&]<std::size_t eye>() {
        if constexpr (pupil_moves<E, eye> && !pupil_moves<Fewer, eye>) {
            const Index e = static_cast<Index>(eye), first = from.first_point(e);
            for (Index i = first; i < first + from.points_of(e); ++i) {
                to.position.col(i) = moved_points(from, pupils).col(i);
                to.log_scale.col(i).template head<2>().array() +=
                    std::log(pupils.map[eye].stretch(Vec3<T>(from.position.col(i))));
            }
        }
    });
}

} // namespace detail

/// The avatar without what the effects that are left out gave.
template <EffectSet Fewer, class T, EffectSet E>
TwoStream<T, Fewer> restricted(const TwoStream<T, E>& all) {
    TwoStream<T, Fewer> a;
    const FaceStream<T, E>& from = all.face;
    FaceStream<T, Fewer>& to = a.face;
    to.position = from.position;
    to.log_scale = from.log_scale;
    to.rotation = from.rotation;
    to.opacity_logit = from.opacity_logit;
    detail::copy_slot(from.feature, to.feature);
    detail::copy_slot(from.landmarks, to.landmarks);
    detail::copy_slot(from.anchor, to.anchor);
    for_face_fields<Fewer>([&](auto by) {
        by.color(to.networks) = by.color(from.networks);
        by.deform(to.networks) = by.deform(from.networks);
        if constexpr (by.attributes) by.attribute(to) = by.attribute(from);
    });
    if constexpr (face_rests<E>)
        to.rest_color = from.rest_color;
    else if constexpr (face_rests<Fewer>)
        for_face_fields<E>([&](auto by) { // as many channels as the networks give
            to.rest_color.setZero(by.color(from.networks).shape.outputs(), to.position.cols());
        });
    const EyeStream<T, E>& eyes = all.eyes;
    if constexpr (std::same_as<EyeAppearanceOf<Fewer>, EyeAppearanceOf<E>>)
        a.eyes.appearance() = eyes.appearance();
    else if constexpr (requires { a.eyes.feature = eyes.feature; })
        a.eyes.feature = eyes.feature; // constants; what is generated has no parameters then
    if constexpr (std::same_as<GazeMechanismOf<Fewer>, GazeMechanismOf<E>>)
        a.eyes.mechanism() = eyes.mechanism();
    a.eyes.log_scale = eyes.log_scale;
    a.eyes.rotation = eyes.rotation;
    a.eyes.opacity_logit = eyes.opacity_logit;
    a.eyes.position = eyes.position;
    a.eyes.centre = eyes.centre;
    a.eyes.spacing = eyes.spacing;
    a.eyes.left_points = eyes.left_points;
    detail::copy_slot(eyes.offset, a.eyes.offset);
    detail::copy_slot(eyes.kappa, a.eyes.kappa);
    detail::copy_slot(eyes.optics.cornea, a.eyes.optics.cornea);
    detail::copy_slot(eyes.optics.index, a.eyes.optics.index);
    detail::copy_slot(eyes.optics.light_position, a.eyes.optics.light_position);
    detail::copy_slot(eyes.optics.light_intensity, a.eyes.optics.light_intensity);
    detail::copy_slot(eyes.optics.light_width, a.eyes.optics.light_width);
    detail::copy_slot(eyes.lid_shadow, a.eyes.lid_shadow);
    detail::copy_slot(eyes.lid_line, a.eyes.lid_line);
    a.upsampler = all.upsampler;
    detail::copy_slot(all.delta_pose, a.delta_pose);
    detail::copy_slot(all.delta_gaze, a.delta_gaze);
    detail::copy_slot(all.delta_view, a.delta_view);
    detail::copy_slot(all.shading, a.shading);
    detail::copy_slot(all.view_color, a.view_color);
    return a;
}

/// The avatar with fewer effects that looks as it does at these drivers.
template <EffectSet Fewer, class T, EffectSet E, Backend B>
TwoStream<T, Fewer> held(const B& backend, const TwoStream<T, E>& all, const AvatarConfig& config,
                         const LandmarkRoles& roles, const Drivers<T, E>& drivers) {
    TwoStream<T, Fewer> a = restricted<Fewer>(all);
    TwoStreamTrace<T, E> trace;
    constexpr bool shaded = has_effect<E, HeadShading> && has_effect<Fewer, HeadShading>,
                   lids = has_effect<E, LidShadow> && has_effect<Fewer, LidShadow>,
                   own_lights = has_effect<E, Glint> && has_effect<Fewer, Glint>,
                   // What lids take from highlights that stay is kept, as this camera sees them.
                   darkened = own_lights && has_effect<E, LidShadow> && !lids,
                   lit = own_lights && !darkened;
    if constexpr (shaded || lit || has_effect<E, ViewColor>) {
        TwoStream<T, E> plain = all; // what is kept is shaded, and has highlights, again
        if constexpr (has_effect<E, ViewColor>) plain.view_color = {};
        if constexpr (shaded) plain.shading = {};
        if constexpr (lit) resize_lights(plain.eyes.optics, 0);
        drive(backend, plain, {config, roles, drivers}, trace);
    } else {
        drive(backend, all, {config, roles, drivers}, trace);
    }
    [[maybe_unused]] const FaceTrace<T, E>& t = trace.face;
    FaceStream<T, Fewer>& face = a.face;
    if constexpr (face_rests<Fewer> && has_effect<Fewer, FaceDrivers>)
        face.anchor = all.face.seen();
    if constexpr (face_rests<Fewer>)
        for_face_fields<E>([&](auto by) {
            if constexpr (!detail::drives<Fewer>(by)) {
                const auto add = [&](const FieldTrace<T>& field, double gain, auto&& to) {
                    for (std::size_t k = 0; k < field.set.size(); ++k) {
                        const Index i = field.set[k];
                        to(i, T(T(gain) * by.influence(t.weights)(0, i)),
                           VecX<T>(field.output.col(static_cast<Index>(k))));
                    }
                };
                add(by.color(t), 1, [&](Index i, const T& w, const VecX<T>& y) {
                    face.rest_color.col(i) += w * y;
                });
                add(by.deform(t), config.deform_scale, [&](Index i, const T& w, const VecX<T>& y) {
                    face.position.col(i) += w * y;
                });
                if constexpr (by.attributes)
                    add(by.attribute(t), config.attribute_scale,
                        [&](Index i, const T& w, const VecX<T>& y) {
                            face.log_scale.col(i) += w * y.head(3);
                            face.rotation.col(i) += w * y.segment(3, 4);
                            face.opacity_logit(0, i) += w * y(7);
                        });
            }
        });
    if constexpr (lids && face_rests<Fewer>)
        for (Index k = 0; k < a.eyes.lid_line.cols(); ++k) { // as far as its Gaussian is kept
            const Index i = detail::lid_column(a.eyes.lid_line, k);
            a.eyes.lid_line.col(k).template tail<2>() +=
                (face.position.col(i) - all.face.position.col(i)).template head<2>();
        }
    if constexpr (has_effect<E, Pupil>)
        detail::keep_pupils<Fewer>(all.eyes, trace.eyes.pupils, a.eyes);
    if constexpr (has_effect<E, CornealRefraction> && !has_effect<Fewer, CornealRefraction>)
        if (all.eyes.optics.refracts()) {
            require(!lids && !EyeAppearanceOf<Fewer>::reads_inputs, "held",
                    "shadows of lids and driven features read points before they are refracted, "
                    "expected them left out with the refraction");
            a.eyes.position << trace.eyes.optics.seen[0], trace.eyes.optics.seen[1];
        }
    if constexpr (EyeAppearanceOf<E>::reads_inputs && !EyeAppearanceOf<Fewer>::reads_inputs) {
        a.eyes.feature = trace.gaussians.feature.rightCols(a.eyes.position.cols());
        if constexpr (lids) detail::before_lid_shadow(all.eyes, trace.eyes, a.eyes.feature);
        if constexpr (darkened) {
            Columns<T> light = Columns<T>::Zero(a.eyes.feature.rows(), a.eyes.feature.cols());
            detail::keep_highlights(backend, all.eyes, drivers.camera, trace.eyes, light);
            a.eyes.feature -= light;
        }
    } else {
        if constexpr (has_effect<E, Glint> && !has_effect<Fewer, Glint>)
            detail::keep_highlights(backend, all.eyes, drivers.camera, trace.eyes, a.eyes.feature);
        if constexpr (has_effect<E, LidShadow> && !has_effect<Fewer, LidShadow>)
            detail::keep_lid_shadow(all.eyes, trace.eyes, a.eyes.feature);
    }
    if constexpr (std::same_as<EyeAppearanceOf<E>, DrivenFeatures> &&
                  std::same_as<EyeAppearanceOf<Fewer>, DrivenFeatures>) {
        static_assert(eye_turns<E, 0> == eye_turns<Fewer, 0> &&
                          eye_turns<E, 1> == eye_turns<Fewer, 1>,
                      "held: driven features need the gaze of their eye");
        for (Mlp<T>& mlp : a.eyes.networks) {
            constexpr bool rotation = has_effect<E, ReadsHeadPose>,
                           expression = has_effect<E, ReadsExpression>;
            if constexpr (expression && !has_effect<Fewer, ReadsExpression>)
                mlp = detail::with_held_inputs<T>(mlp, {rotation ? 6 : 3, drivers.expression});
            if constexpr (rotation && !has_effect<Fewer, ReadsHeadPose>)
                mlp = detail::with_held_inputs<T>(mlp,
                                                  {3, VecX<T>(drivers.pose.template head<3>())});
        }
    }
    if constexpr (has_effect<E, ViewColor> && !has_effect<Fewer, ViewColor>)
        if (all.has_view_color()) {
            constexpr bool constant = face_rests<Fewer> && requires { a.eyes.feature; };
            require(constant && !lids, "held",
                    "colours that depend on the view are kept by a face and eyes of constant "
                    "colours, expected ViewColor among the effects");
            if constexpr (constant) {
                trace.gaussians.feature.setZero();
                add_view_colors(backend, all.view_color, detail::seen_head_of(drivers, trace),
                                trace.gaussians);
                face.rest_color += trace.gaussians.feature.leftCols(trace.face_count);
                a.eyes.feature += trace.gaussians.feature.rightCols(a.eyes.position.cols());
            }
        }
    const OpticalDrivers<T, E> optical = optical_drivers(all.eyes, drivers);
    for_eyes([&]<std::size_t eye>() {
        if constexpr (eye_turns<E, eye> && !eye_turns<Fewer, eye>) {
            EyeTransform<T> turn = detail::eye_at<T>(Vec3<T>::Zero());
            detail::turn_eye_by(all.eyes, eye, of_eye<eye>(optical.drivers.gaze), turn);
            const Index first = a.eyes.first_point(static_cast<Index>(eye));
            const Index n = a.eyes.points_of(static_cast<Index>(eye));
            const Columns<T> points = a.eyes.position.middleCols(first, n);
            const Columns<T> rotations = a.eyes.rotation.middleCols(first, n);
            a.eyes.position.middleCols(first, n) = eye_points<T>(turn, points);
            a.eyes.rotation.middleCols(first, n) = eye_rotations<T>(turn, rotations);
            if constexpr (has_effect<Fewer, SeesCornea>)
                detail::turn_cornea(a.eyes.optics, eye, turn.rotation);
        }
    });
    if constexpr (has_effect<E, EyeOffset> && !has_effect<Fewer, EyeOffset>)
        a.eyes.centre += T(config.deform_scale) * trace.eyes.offset.squashed.reshaped(3, 2);
    return a;
}

} // namespace rye
