// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/eye_lights.hpp: the highlights of an eye, point by point: what the cornea
/// (rig/cornea.hpp) mirrors of each light to the camera, what that adds to the colours of the
/// eyeball's Gaussians, and back. Functions of a point run on the host (backend/each.hpp) and on a
/// device (backend/cuda/each.hpp).
/// Frames: lights and camera in the world; points in the eyeball's frame, canonical units.
#pragma once

#include <rye/backend/each.hpp>
#include <rye/core/column_array.hpp>
#include <rye/rig/cornea.hpp>
#include <rye/rig/eye_transform.hpp>

namespace rye {

namespace detail {

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
    const T* width;     ///< 1 x L [rad]
    Index count;        ///< L
};

} // namespace detail

/// A light before an eye, and the camera; in the eyeball's frame.
template <class T>
struct SeenLight {
    Vec3<T> camera;
    Vec3<T> from_cornea; ///< the light, from the cornea's centre
    Vec3<T> to;          ///< the same of unit length
    T width;             ///< [rad]
};

namespace detail {

/// Returns light l before an eye; `camera` is a point of the world.
template <Scalar T>
RYE_HD SeenLight<T> see_light(const LightArrays<T>& lights, int eye, Index l,
                              const EyeTransform<T>& placed, const Vec3<T>& camera) {
    SeenLight<T> seen;
    seen.camera = into_eye(placed, camera);
    seen.from_cornea =
        into_eye(placed, column3(lights.position, l)) - cornea_in(lights.cornea, eye).centre;
    seen.to = normalized(seen.from_cornea);
    seen.width = lights.width[l];
    return seen;
}

/// Points of an eye whose front shows lights.
template <class T>
struct LitPoints {
    const T* position; ///< in the eyeball's frame, 3 x P
    const T* seen;     ///< the same as they are seen through the cornea, 3 x P
    const T* cornea;   ///< that eye's, cornea_numbers

    /// Returns what the cornea mirrors at point i; nothing on the eyeball's back.
    RYE_HD Mirrored<T> at(Index i, const Vec3<T>& camera) const {
        const Cornea<T> c = cornea_in(cornea, 0);
        if (!(dot(column3(position, i), c.axis) > T(0))) return {Vec3<T>(T(0), T(0), T(0)), T(0)};
        return mirrored(c, camera, column3(seen, i));
    }
};

/// Adds the highlights of an eye's lights to the first channels of point i. Arrays begin at that
/// eye's first point.
template <class T>
struct LightEyePoint {
    static constexpr const char* name = "eyes, highlights";
    LitPoints<T> points;
    const SeenLight<T>* lights; ///< of that eye, `count`
    const T* intensity;         ///< light_channels x count
    Index count, channels;      ///< of lights, of a feature
    T* feature;                 ///< channels x P

    RYE_HD void operator()(Index i) const {
        const Mirrored<T> mirror = points.at(i, lights->camera);
        if (!(mirror.strength > T(0))) return;
        T* const colour = feature + channels * i;
        for (Index l = 0; l < count; ++l) {
            const T value = mirror.strength * light_lobe(mirror.to, lights[l].to, lights[l].width);
            for (int c = 0; c < light_channels; ++c)
                colour[c] += intensity[light_channels * l + c] * value;
        }
    }
};

/// Adds what point i of an eye gives to the gradient of one light: sums of the cotangents of its
/// direction (3), of the camera (3) and of its intensity.
template <class T>
struct LightEyePointVjp {
    using Number = T;
    static constexpr const char* name = "eyes, highlights, reverse";
    static constexpr int to_at = 0, camera_at = 3, intensity_at = 6;
    static constexpr int sums = intensity_at + light_channels;
    LitPoints<T> points;
    const SeenLight<T>* light;
    const T* intensity; ///< of that light, light_channels
    Index channels;     ///< of a feature
    const T* g_feature; ///< channels x P
    T* g_seen;          ///< 3 x P, added to, or null

    template <class Sums>
    RYE_HD void operator()(Index i, Sums& sum) const {
        const Mirrored<T> mirror = points.at(i, light->camera);
        if (!(mirror.strength > T(0))) return;
        const T lobe = light_lobe(mirror.to, light->to, light->width);
        const T* const g_colour = g_feature + channels * i;
        T g(0);
        for (int c = 0; c < light_channels; ++c) {
            g += g_colour[c] * intensity[c];
            sum[std::size_t(intensity_at + c)] += g_colour[c] * mirror.strength * lobe;
        }
        const T g_dot = g * mirror.strength * lobe / (light->width * light->width);
        Mirrored<T> g_mirror{light->to, g * lobe};
        for (int k = 0; k < 3; ++k) {
            g_mirror.to[k] *= g_dot;
            sum[std::size_t(to_at + k)] += g_dot * mirror.to[k];
        }
        Vec3<T> g_camera(T(0), T(0), T(0));
        const Vec3<T> g_at = mirrored_vjp(cornea_in(points.cornea, 0), light->camera,
                                          column3(points.seen, i), g_mirror, g_camera);
        for (int k = 0; k < 3; ++k) sum[std::size_t(camera_at + k)] += g_camera[k];
        if (g_seen != nullptr) add_column<3>(g_at, g_seen, i);
    }
};

} // namespace detail

/// Cotangents of the camera and of a light, in the eyeball's frame.
template <class T>
struct LightGradient {
    Vec3<T> camera, light;
};
/// Returns them, given the sums of LightEyePointVjp.
template <class T, class Sums>
RYE_HD LightGradient<T> light_vjp(const SeenLight<T>& light, const Sums& sum) {
    constexpr int camera = detail::LightEyePointVjp<T>::camera_at;
    return {Vec3<T>(sum[camera], sum[camera + 1], sum[camera + 2]),
            normalized_vjp(light.from_cornea, Vec3<T>(sum[0], sum[1], sum[2]))};
}

namespace detail {

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

} // namespace detail

} // namespace rye
