// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/eye_lights.hpp: the highlights of an eye, light by light and point by point: what a
/// camera sees of each light in the cornea (rig/cornea.hpp), what that adds to the colours of the
/// eyeball's Gaussians, and back. Functions of a point run on the host (backend/each.hpp) and on a
/// device (backend/cuda/each.hpp).
/// Frames: lights and camera in the world; points in the eyeball's frame, canonical units.
#pragma once

#include <rye/backend/each.hpp>
#include <rye/core/column_array.hpp>
#include <rye/rig/cornea.hpp>
#include <rye/rig/eye_transform.hpp>

namespace rye {

/// Numbers of a cornea in an array: centre, radius, axis, rim, as rig/cornea.hpp's Cornea has them.
inline constexpr Index cornea_numbers = 8;
/// Channels that a light adds to, the first ones.
inline constexpr int light_channels = 3;

/// Returns the cornea of an eye (0: the subject's left) of an array, 8 x 2.
template <Scalar T>
RYE_HD Cornea<T> cornea_in(const T* corneas, int eye) {
    const T* const c = corneas + cornea_numbers * eye;
    return {Vec3<T>(c[0], c[1], c[2]), c[3], Vec3<T>(c[4], c[5], c[6]), c[7]};
}

/// Corneas and lights in memory of the host or of a device.
template <class T>
struct LightArrays {
    const T* cornea;    ///< 8 x 2
    const T* position;  ///< world, 3 x L
    const T* intensity; ///< light_channels x L
    const T* width;     ///< 1 x L [unit]
    Index count;        ///< L
};

/// A light as a frame's camera sees it in a cornea; in the eyeball's frame.
template <class T>
struct SeenLight {
    GlintView<T> view;
    MirrorImage<T> image;
};

/// Returns light l as the camera, a point of the world, sees it in an eye.
template <Scalar T>
RYE_HD SeenLight<T> see_light(const LightArrays<T>& lights, int eye, Index l,
                              const EyeTransform<T>& placed, const Vec3<T>& camera) {
    SeenLight<T> seen;
    seen.view.camera = into_eye(placed, camera);
    seen.view.light = into_eye(placed, column3(lights.position, l));
    seen.view.width = lights.width[l];
    seen.image = mirror_image(cornea_in(lights.cornea, eye), seen.view);
    return seen;
}

/// Points of an eye whose front shows lights.
template <class T>
struct LitPoints {
    const T* position; ///< in the eyeball's frame, 3 x P
    const T* seen;     ///< the same as they are seen through the cornea, 3 x P
    const T* axis;     ///< of the cornea, 3

    /// True if point i lies on the eyeball's front.
    RYE_HD bool in_front(Index i) const {
        return dot(column3(position, i), column3(axis, 0)) > T(0);
    }
};

/// Adds the images of an eye's lights to the first channels of point i. Arrays begin at that eye's
/// first point.
template <class T>
struct LightEyePoint {
    static constexpr const char* name = "eyes, highlights";
    LitPoints<T> points;
    const SeenLight<T>* lights; ///< of that eye, `count`
    const T* intensity;         ///< light_channels x count
    Index count, channels;      ///< of lights, of a feature
    T* feature;                 ///< channels x P

    RYE_HD void operator()(Index i) const {
        if (!points.in_front(i)) return;
        T* const colour = feature + channels * i;
        const Vec3<T> at = column3(points.seen, i);
        for (Index l = 0; l < count; ++l) {
            if (!lights[l].image.seen) continue;
            const T value = glint_at(lights[l].image, lights[l].view, at);
            for (int c = 0; c < light_channels; ++c)
                colour[c] += intensity[light_channels * l + c] * value;
        }
    }
};

/// Adds what point i of an eye gives to the gradient of one light: sums of the cotangents of the
/// image's point (3) and strength (1), of the camera (3) and of the intensity.
template <class T>
struct LightEyePointVjp {
    using Number = T;
    static constexpr const char* name = "eyes, highlights, reverse";
    static constexpr int image_at = 0, strength_at = 3, camera_at = 4, intensity_at = 7;
    static constexpr int sums = intensity_at + light_channels;
    LitPoints<T> points;
    const SeenLight<T>* light;
    const T* intensity; ///< of that light, light_channels
    Index channels;     ///< of a feature
    const T* g_feature; ///< channels x P
    T* g_seen;          ///< 3 x P, added to, or null

    template <class Sums>
    RYE_HD void operator()(Index i, Sums& sum) const {
        if (!light->image.seen || !points.in_front(i)) return;
        const Vec3<T> at = column3(points.seen, i);
        const T value = glint_at(light->image, light->view, at);
        const T* const g_colour = g_feature + channels * i;
        T g(0);
        for (int c = 0; c < light_channels; ++c) {
            g += g_colour[c] * intensity[c];
            sum[std::size_t(intensity_at + c)] += g_colour[c] * value;
        }
        const Vec3<T> zero(T(0), T(0), T(0));
        GlintGradient<T> own{{zero, T(0), true}, zero, zero};
        const Vec3<T> g_at = glint_at_vjp(light->image, light->view, at, T(g * value), own);
        for (int k = 0; k < 3; ++k) {
            sum[std::size_t(image_at + k)] += own.image.at[k];
            sum[std::size_t(camera_at + k)] += own.camera[k];
        }
        sum[strength_at] += own.image.strength;
        if (g_seen != nullptr) add_column<3>(g_at, g_seen, i);
    }
};

/// Returns the cotangents of the camera and of a light, in the eyeball's frame, given the sums of
/// LightEyePointVjp.
template <class T, class Sums>
RYE_HD GlintGradient<T> light_vjp(const Cornea<T>& cornea, const SeenLight<T>& light,
                                  const Sums& sum) {
    using At = LightEyePointVjp<T>;
    GlintGradient<T> g{{Vec3<T>(sum[0], sum[1], sum[2]), sum[At::strength_at], true},
                       Vec3<T>(sum[At::camera_at], sum[At::camera_at + 1], sum[At::camera_at + 2]),
                       Vec3<T>(T(0), T(0), T(0))};
    mirror_image_vjp(cornea, light.view, light.image, g);
    return g;
}

/// Cotangents of an eye's transform to the world, of points that it takes into the eye.
template <class T>
struct IntoEye {
    Mat3<T> rotation = Mat3<T>::Zero();
    Vec3<T> translation = Vec3<T>::Zero();

    /// Adds those of a point in the world, given its cotangent in the eye; returns that of the
    /// point.
    RYE_HD Vec3<T> add(const EyeTransform<T>& eye, const Vec3<T>& world, const Vec3<T>& g) {
        const Vec3<T> scaled = g / eye.scale, g_world = eye.rotation * scaled;
        rotation += (world - eye.translation) * scaled.transpose();
        translation -= g_world;
        return g_world;
    }
};

/// Cotangents of what places an eye in the head, and the head in the world.
template <class T>
struct PlacedEyeCotangent {
    Mat3<T> turn;   ///< of the eye in the head, as a matrix
    Vec3<T> centre; ///< of the eye's centre in the head's frame
    Mat3<T> head_rotation;
    Vec3<T> head_translation;
};

/// Takes the cotangents of an eye's transform to the world apart: R = R_h R_g, t = S R_h c + T.
/// `translation` is T; an eye without a head has none, and the rotation by nothing.
template <Scalar T>
RYE_HD PlacedEyeCotangent<T> placed_eye_vjp(const IntoEye<T>& g, const EyeTransform<T>& eye,
                                            const Vec3<T>& translation) {
    const Mat3<T> back = eye.head_rotation.transpose(), turn = back * eye.rotation;
    const Vec3<T> out = eye.translation - translation, c = back * out;
    PlacedEyeCotangent<T> r;
    r.turn = back * g.rotation;
    r.centre = eye.scale * (back * g.translation);
    r.head_rotation = g.rotation * turn.transpose() + g.translation * c.transpose();
    r.head_translation = g.translation;
    return r;
}

} // namespace rye
