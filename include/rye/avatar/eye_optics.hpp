// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/eye_optics.hpp: what a camera sees of the eyeballs through and on their corneas
/// (rig/cornea.hpp), for the effects CornealRefraction and Glint: parameters, their part of a frame
/// and its vjp. It happens in each eyeball's own frame, before its transform: the camera and the
/// lights are taken there.
/// Frames: parameters in the eyeball's, canonical units; lights and camera in the world.
#pragma once

#include <array>
#include <cstddef>

#include <rye/avatar/drivers.hpp>
#include <rye/avatar/head_pose.hpp>
#include <rye/backend/backend.hpp>
#include <rye/rig/cornea.hpp>
#include <rye/rig/eye_transform.hpp>
#include <rye/rig/eyeball.hpp>

namespace rye {

/// The effects that look at the cornea.
using SeesCornea = AnyOf<CornealRefraction, Glint>;

/// Corneas and lights of both eyes, for the effects that see them; fields of other effects are
/// absent.
template <class T, EffectSet E = PaperEffects>
struct EyeOptics {
    /// Fixed, an eye a column: centre, radius, axis, rim of rig/cornea.hpp's Cornea, 8 x 2.
    [[no_unique_address]] Slot<E, SeesCornea, Columns<T>> cornea;
    [[no_unique_address]] Slot<E, CornealRefraction, Columns<T>> index;  ///< fixed, 1 x 2
    [[no_unique_address]] Slot<E, Glint, Columns<T>> light_position;     ///< world, 3 x L
    /// Colour that a light's image adds to the first channels at its middle, 3 x L or fewer rows.
    [[no_unique_address]] Slot<E, Glint, Columns<T>, 1> light_intensity;
    /// Fixed: the image's deviation [unit], 1 x L. Gaussians that are farther apart do not show it.
    [[no_unique_address]] Slot<E, Glint, Columns<T>, 2> light_width;

    template <class F, class... P>
    static void fields([[maybe_unused]] F&& f, [[maybe_unused]] P&&... p) {
        if constexpr (has_effect<E, Glint>) {
            f("light_position", p.light_position...);
            f("light_intensity", p.light_intensity...);
        }
    }
    template <class F, class... P>
    static void buffers([[maybe_unused]] F&& f, [[maybe_unused]] P&&... p) {
        if constexpr (has_effect<E, SeesCornea>) f("cornea", p.cornea...);
        if constexpr (has_effect<E, CornealRefraction>) f("refractive_index", p.index...);
        if constexpr (has_effect<E, Glint>) f("light_width", p.light_width...);
    }
};

/// The cornea of an eyeball's shape.
template <Real T, EffectSet S>
    requires has_effect<S, CornealBulge>
Cornea<T> cornea_of(const BasicEyeballShape<S>& shape) {
    return {Vec3<T>(T(0), T(0), static_cast<T>(shape.cornea_offset)),
            static_cast<T>(shape.cornea_radius), Vec3<T>(T(0), T(0), T(1)),
            static_cast<T>(shape.limbus_plane())};
}

/// The cornea of an eye (0: the subject's left) of the 8 x 2 parameter.
template <class T>
Cornea<T> cornea_of(const Columns<T>& cornea, std::size_t eye) {
    const Index e = static_cast<Index>(eye);
    require(cornea.rows() == 8 && cornea.cols() == 2, "eye_optics", "got corneas of ",
            cornea.rows(), " x ", cornea.cols(), ", expected 8 x 2: see set_corneas");
    return {cornea.template block<3, 1>(0, e), cornea(3, e), cornea.template block<3, 1>(4, e),
            cornea(7, e)};
}

/// The corneas of both eyes, and no light yet.
template <Real T, EffectSet E>
    requires has_effect<E, SeesCornea>
void set_corneas(EyeOptics<T, E>& optics, const Cornea<T>& left, const Cornea<T>& right,
                 double index = aqueous_index) {
    optics.cornea.resize(8, 2);
    for (Index k = 0; k < 3; ++k) {
        optics.cornea.row(k) << left.centre[k], right.centre[k];
        optics.cornea.row(4 + k) << left.axis[k], right.axis[k];
    }
    optics.cornea.row(3) << left.radius, right.radius;
    optics.cornea.row(7) << left.rim, right.rim;
    if constexpr (has_effect<E, CornealRefraction>)
        optics.index = Columns<T>::Constant(1, 2, static_cast<T>(index));
    if constexpr (has_effect<E, Glint>) {
        optics.light_position.resize(3, 0);
        optics.light_intensity.resize(3, 0);
        optics.light_width.resize(1, 0);
    }
}

/// Turns an eye's cornea with its points.
template <class T, EffectSet E>
    requires has_effect<E, SeesCornea>
void turn_cornea(EyeOptics<T, E>& optics, std::size_t eye, const Mat3<T>& rotation) {
    const Index e = static_cast<Index>(eye);
    for (const Index row : {Index(0), Index(4)}) {
        const Vec3<T> x = optics.cornea.template block<3, 1>(row, e);
        optics.cornea.template block<3, 1>(row, e) = rotation * x;
    }
}

/// Intermediate results of the eyes' optics for their vjp.
template <class T>
struct OpticsTrace {
    std::array<Columns<T>, 2> seen;        ///< each eye's points, its own frame, 3 x P
    std::array<EyeTransform<T>, 2> placed;
};

/// Terms that the view of the corneas adds to the cotangents of the eyes' transforms.
template <class T>
struct OpticsCotangent {
    std::array<Mat3<T>, 2> turn{Mat3<T>::Zero(), Mat3<T>::Zero()}; ///< eye to head, as a matrix
    Columns<T> centre = Columns<T>::Zero(3, 2);                    ///< head frame
    HeadTransformGradient<T> head;
};

/// An eye before a camera.
template <class T>
struct ViewedEye {
    std::size_t eye;
    const Vec3<T>& camera; ///< its centre, world
    const EyeTransform<T>& placed;
    const Columns<T>& points; ///< in the eye's frame, 3 x P
    Index first;              ///< column of the eyes' features
};

/// Computes the points of one eye as they are seen; adds the glints to its columns of `feature`.
template <class T, EffectSet E, Backend B>
void look_into_eye(const B& backend, const EyeOptics<T, E>& optics,
                   const std::type_identity_t<ViewedEye<T>>& viewed, OpticsTrace<T>& trace,
                   [[maybe_unused]] Columns<T>& feature) {
    using std::isfinite;
    const std::size_t eye = viewed.eye;
    const EyeTransform<T>& placed = viewed.placed;
    const Columns<T>& points = viewed.points;
    require(isfinite(viewed.camera[0]) && isfinite(viewed.camera[1]) && isfinite(viewed.camera[2]),
            "eye_optics", "got drivers without a camera, expected its centre in the world");
    const Cornea<T> cornea = cornea_of(optics.cornea, eye);
    const Vec3<T> camera = into_eye(placed, viewed.camera);
    const Index n = points.cols();
    trace.placed[eye] = placed;
    trace.seen[eye] = points;
    // By pointers: blocks of matrices cost a few instructions a point more.
    const T* const at = points.data();
    T* const seen = trace.seen[eye].data();
    const auto point = [](const T* p, Index i) { return Eigen::Map<const Vec3<T>>(p + 3 * i); };
    if constexpr (has_effect<E, CornealRefraction>) {
        const RefractingCornea<T> refracting{cornea, optics.index(0, static_cast<Index>(eye))};
        for_chunks(backend.threads, n, 256, [&](Index b, Index e, Index) {
            for (Index i = b; i < e; ++i)
                Eigen::Map<Vec3<T>>(seen + 3 * i) =
                    seen_through<T>(refracting, camera, point(at, i));
        });
    }
    if constexpr (has_effect<E, Glint>)
        for (Index l = 0; l < optics.light_width.cols(); ++l) {
            const GlintView<T> view{camera, into_eye<T>(placed, optics.light_position.col(l)),
                                    optics.light_width(0, l)};
            const MirrorImage<T> image = mirror_image(cornea, view);
            if (!image.seen) continue;
            const Index channels = optics.light_intensity.rows(), stride = feature.rows();
            const T* const intensity = optics.light_intensity.data() + l * channels;
            T* colour = feature.data() + viewed.first * stride;
            for (Index i = 0; i < n; ++i, colour += stride) {
                const Vec3<T> x = point(at, i);
                if (!(dot(x, cornea.axis) > T(0))) continue;  // the eyeball's back
                const T value = glint_at<T>(image, view, point(seen, i));
                for (Index c = 0; c < channels; ++c) colour[c] += intensity[c] * value;
            }
        }
}

namespace detail {

/// Cotangents of an eye's transform, of points that it takes into the eye.
template <class T>
struct IntoEye {
    Mat3<T> rotation = Mat3<T>::Zero();
    Vec3<T> translation = Vec3<T>::Zero();

    /// Adds one point's; returns the cotangent of the point in the world.
    Vec3<T> add(const EyeTransform<T>& eye, const Vec3<T>& world, const Vec3<T>& g) {
        const Vec3<T> scaled = g / eye.scale, g_world = eye.rotation * scaled;
        rotation += (world - eye.translation) * scaled.transpose();
        translation -= g_world;
        return g_world;
    }
};

/// Cotangents of the points as they are seen, in the eye's frame, and of the colours.
template <class T>
struct SeenCotangent {
    Columns<T>& seen;
    const Columns<T>& feature;
};

/// One eye's part of eye_optics_vjp.
template <class T, EffectSet E>
IntoEye<T> look_into_eye_vjp(const EyeOptics<T, E>& optics,
                             const std::type_identity_t<ViewedEye<T>>& viewed,
                             const OpticsTrace<T>& trace,
                             const std::type_identity_t<SeenCotangent<T>>& cotangent,
                             [[maybe_unused]] EyeOptics<T, E>& grad) {
    const std::size_t eye = viewed.eye;
    const EyeTransform<T>& placed = viewed.placed;
    const Columns<T>& points = viewed.points;
    Columns<T>& g_seen = cotangent.seen;
    [[maybe_unused]] const Columns<T>& g_feature = cotangent.feature;
    const Cornea<T> cornea = cornea_of(optics.cornea, eye);
    const Vec3<T> camera = into_eye(placed, viewed.camera);
    Vec3<T> g_camera = Vec3<T>::Zero();
    IntoEye<T> sum;
    if constexpr (has_effect<E, Glint>)
        for (Index l = 0; l < optics.light_width.cols(); ++l) {
            const Vec3<T> at = optics.light_position.col(l);
            const GlintView<T> view{camera, into_eye(placed, at), optics.light_width(0, l)};
            const MirrorImage<T> image = mirror_image(cornea, view);
            if (!image.seen) continue;
            GlintGradient<T> g_glint{{Vec3<T>::Zero(), T(0), true}, g_camera, Vec3<T>::Zero()};
            for (Index i = 0; i < points.cols(); ++i) {
                const Vec3<T> x = points.col(i), y = trace.seen[eye].col(i);
                if (!(dot(x, cornea.axis) > T(0))) continue;
                const T value = glint_at(image, view, y);
                T g(0);
                for (Index c = 0; c < optics.light_intensity.rows(); ++c) {
                    g += g_feature(c, i) * optics.light_intensity(c, l);
                    grad.light_intensity(c, l) += g_feature(c, i) * value;
                }
                g_seen.col(i) += glint_at_vjp(image, view, y, T(g * value), g_glint);
            }
            mirror_image_vjp(cornea, view, image, g_glint);
            g_camera = g_glint.camera;
            grad.light_position.col(l) += sum.add(placed, at, g_glint.light);
        }
    if constexpr (has_effect<E, CornealRefraction>) {
        const RefractingCornea<T> refracting{cornea, optics.index(0, static_cast<Index>(eye))};
        for (Index i = 0; i < points.cols(); ++i)
            seen_through_vjp<T>(refracting, camera, points.col(i), g_seen.col(i), g_camera);
    }
    sum.add(placed, viewed.camera, g_camera);
    return sum;
}

} // namespace detail

/// Both eyes before the camera.
template <class T>
struct ViewedEyes {
    const Vec3<T>& camera;      ///< its centre, world
    const Columns<T>& position; ///< both eyes' points
    const OpticsTrace<T>& trace;
};

/// Head-frame cotangents of the eyes' Gaussians: columns of a cloud's from `begin` on.
template <class T>
struct EyesCotangent {
    const Gaussians<T>& gaussians;
    Index begin;
};

/// Destinations of eye_optics_vjp: gradients that it adds to, cotangents that it sets.
template <class T, EffectSet E>
struct OpticsGradients {
    EyeOptics<T, E>& lights;
    OpticsCotangent<T>& eyes;
};

/// Accumulates the lights' gradients, and gives what the camera and the lights, taken into the
/// eyes, add to those of the transforms. `head` is the HeadTransform of an avatar that has one.
template <class T, EffectSet E, class... Head>
    requires has_effect<E, SeesCornea>
void eye_optics_vjp(const EyeOptics<T, E>& optics,
                    const std::type_identity_t<ViewedEyes<T>>& viewed,
                    const std::type_identity_t<EyesCotangent<T>>& cotangent,
                    const std::type_identity_t<OpticsGradients<T, E>>& gradients,
                    const Head&... head) {
    const OpticsTrace<T>& trace = viewed.trace;
    const Gaussians<T>& g = cotangent.gaussians;
    const Index begin = cotangent.begin;
    OpticsCotangent<T>& out = gradients.eyes;
    Index first = 0, n = 0;
    for (std::size_t eye = 0; eye < 2; ++eye, first += n) {
        n = trace.seen[eye].cols();
        const EyeTransform<T>& placed = trace.placed[eye];
        Mat3<T> turn = placed.rotation;                      // eye to head
        ((turn = head.rotation.transpose() * placed.rotation), ...);
        Columns<T> g_seen = turn.transpose() * g.mean.middleCols(begin + first, n);
        const detail::IntoEye<T> into = detail::look_into_eye_vjp<T, E>(
            optics, {eye, viewed.camera, placed, viewed.position.middleCols(first, n), first},
            trace, {g_seen, g.feature.middleCols(begin + first, n)}, gradients.lights);
        out.turn[eye] = into.rotation;
        out.centre.col(static_cast<Index>(eye)) = into.translation;
        [[maybe_unused]] const auto by_head = [&](const auto& h) {
            // R = R_h R_g, t = S R_h c + T.
            const Vec3<T> centre = placed.translation - h.translation;  // S R_h c
            const Vec3<T> c = h.rotation.transpose() * centre;
            out.head.rotation +=
                into.rotation * turn.transpose() + into.translation * c.transpose();
            out.head.translation += into.translation;
            out.turn[eye] = h.rotation.transpose() * into.rotation;
            out.centre.col(static_cast<Index>(eye)) =
                h.scale * (h.rotation.transpose() * into.translation);
        };
        (by_head(head), ...);
    }
}

} // namespace rye
