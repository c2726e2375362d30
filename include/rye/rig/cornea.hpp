// SPDX-License-Identifier: Apache-2.0
/// rye/rig/cornea.hpp: optics of a spherical cornea for one eye: refraction displaces the iris, and
/// the reflections of lights, the highlights, are added to the colours. Frame: the eyeball's,
/// origin at its centre; lengths in canonical head units; the camera and the lights are points of
/// that frame.
/// Approximations: a Gaussian's centre moves onto its refracted ray, as far behind the cornea
/// along that ray as before; its shape is unchanged. The corneal sphere continues below the
/// sclera. A point whose light is totally reflected on its way to the camera moves to the rim. A
/// light is a lobe of directions about the line from the cornea's centre to it, mirrored alike at
/// all angles of incidence, and not beyond the limbus.
/// Source: Fermat's principle (geometry/sphere_path.hpp); radii of Gullstrand's eye; lobes are
/// spherical Gaussians (Wang et al., "All-frequency rendering of dynamic, spatially-varying
/// reflectance", 2009).
#pragma once

#include <cmath>

#include <rye/autodiff/dual.hpp>
#include <rye/geometry/sphere_path.hpp>
#include <rye/math/scalar.hpp>

namespace rye {

namespace detail {

/// Refractive index of the aqueous humour relative to air (Gullstrand).
inline constexpr double aqueous_index = 1.336;
/// Refractive index of the cornea's own tissue relative to air (Gullstrand): that of rendered
/// captures, and the one that a trained avatar begins with.
inline constexpr double corneal_index = 1.376;
/// Cosine of the angle of incidence below which a highlight fades.
inline constexpr double mirror_grazing = 0.3;
/// Width of the rim on which a highlight fades, over the corneal radius.
inline constexpr double mirror_rim = 0.1;

} // namespace detail

/// A cornea in its eyeball's frame.
template <Scalar T>
struct Cornea {
    Vec3<T> centre;              ///< centre of the corneal sphere [unit]
    T radius;                    ///< radius of the corneal sphere [unit]
    Vec3<T> axis;                ///< direction out of the eye, unit length
    T rim;                       ///< limbus along the axis, from the eyeball's centre [unit]
};

/// A cornea and the refractive index behind it.
template <Scalar T>
struct RefractingCornea {
    Cornea<T> cornea;
    T index;
};

namespace detail {

template <Scalar T>
RYE_HD Vec3<T> beyond(const Vec3<T>& at, const Vec3<T>& eye, const Vec3<T>& source) {
    const Vec3<T> ray = normalized(Vec3<T>(at - eye));
    const T depth = norm(Vec3<T>(at - source));
    return Vec3<T>(at[0] + depth * ray[0], at[1] + depth * ray[1], at[2] + depth * ray[2]);
}

template <Scalar T>
RYE_HD bool behind_cornea(const RefractingCornea<T>& refracting, const Vec3<T>& eye,
                          const Vec3<T>& point) {
    const Cornea<T>& c = refracting.cornea;
    const Vec3<T> p = point - c.centre, e = eye - c.centre;
    const T rr = c.radius * c.radius;
    return refracting.index != T(1) && dot(p, p) < rr && dot(e, e) > rr;
}

} // namespace detail

/// Returns the apparent position of a point: refracted if it is within the corneal sphere and the
/// camera is outside, else unchanged. An index of 1 changes no bit.
template <Scalar T>
RYE_HD Vec3<T> seen_through(const RefractingCornea<T>& refracting, const Vec3<T>& camera,
                            const Vec3<T>& point) {
    if (!detail::behind_cornea(refracting, camera, point)) return point;
    const Cornea<T>& c = refracting.cornea;
    const Vec3<T> eye = camera - c.centre, source = point - c.centre;
    const SpherePath<T> path = sphere_path(eye, source, {c.radius, refracting.index});
    return c.centre + detail::beyond(path.at, eye, source);
}

/// Cotangents of what is the same for all points behind a cornea.
template <Scalar T>
struct SeenThroughGradient {
    Vec3<T> camera;
    T index;
};

/// Returns the cotangent of the point; adds those of camera and index to `sum`. The rim does not
/// move with the index; at an index of 1, where nothing is refracted, its cotangent is 0.
template <Scalar T>
RYE_HD Vec3<T> seen_through_vjp(const RefractingCornea<T>& refracting, const Vec3<T>& camera,
                                const Vec3<T>& point, const Vec3<T>& g,
                                SeenThroughGradient<T>& sum) {
    if (!detail::behind_cornea(refracting, camera, point)) return g;
    const Cornea<T>& c = refracting.cornea;
    const T& index = refracting.index;
    const Vec3<T> eye = camera - c.centre, source = point - c.centre;
    const SpherePath<T> path = sphere_path(eye, source, {c.radius, index});
    if (!path.seen) {  // on the rim: derivatives of the closed formula
        struct Rim {};
        using D = Dual<T, 6, Rim>;
        Vec3<D> e, s;
        for (int i = 0; i < 3; ++i) {
            e[i] = D::variable(eye[i], i);
            s[i] = D::variable(source[i], 3 + i);
        }
        const detail::PathPlane<D> plane(e, s, D(c.radius), D(index));
        const Vec3<D> a = detail::beyond(plane.at(plane.rim()).at, e, s);
        Vec3<T> r(T(0), T(0), T(0));
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 3; ++k) {
                sum.camera[k] += g[i] * a[i].d[static_cast<std::size_t>(k)];
                r[k] += g[i] * a[i].d[static_cast<std::size_t>(3 + k)];
            }
        return r;
    }
    const Vec3<T> from_eye = path.at - eye, from_source = path.at - source;
    const T far = norm(from_eye), depth = norm(from_source);
    const Vec3<T> ray = from_eye / far, up = normalized(from_source);
    const T along = dot(g, ray);
    Vec3<T> turn, g_at;                                     // turn: of the ray, over its length
    for (int i = 0; i < 3; ++i) {
        turn[i] = depth / far * (g[i] - ray[i] * along);
        g_at[i] = g[i] + up[i] * along + turn[i];
    }
    const detail::SpherePathCotangent<T> ends =
        detail::sphere_path_vjp(eye, source, {c.radius, index}, path.at, g_at);
    sum.index += ends.index;
    Vec3<T> r;
    for (int i = 0; i < 3; ++i) {
        sum.camera[i] += ends.eye[i] - turn[i];
        r[i] = ends.source[i] - up[i] * along;
    }
    return r;
}

namespace detail {

/// Returns the smoothstep 3x^2 - 2x^3 of x clamped to [0, 1].
template <Scalar T>
RYE_HD T smooth_step(const T& x) {
    const T u = x > T(0) ? (x < T(1) ? x : T(1)) : T(0);
    return u * u * (T(3) - T(2) * u);
}
template <Scalar T>
RYE_HD T smooth_step_slope(const T& x) {
    return x > T(0) && x < T(1) ? T(T(6) * x * (T(1) - x)) : T(0);
}

/// The point where a camera's ray meets the corneal sphere, and what is mirrored there; by
/// vectors of the cornea's size, so that rounding does not grow with the camera's distance.
template <Scalar T>
struct MirrorRay {
    Vec3<T> point;  ///< from the cornea's centre
    Vec3<T> view;   ///< the ray's unit direction
    T along;        ///< of the point, along the ray
    Vec3<T> off;    ///< from the centre to the ray, across it
    T inside;       ///< half the chord within the sphere, squared; below 0 if the ray misses
    T chord;        ///< its root
    Vec3<T> normal; ///< of the cornea where the ray meets it, unit length
    T facing;       ///< dot(view, normal)
    T rim, grazing; ///< arguments to the smooth steps whose product is the strength

    RYE_HD MirrorRay(const Cornea<T>& c, const Vec3<T>& camera, const Vec3<T>& at)
        : point(at - c.centre), view(normalized(Vec3<T>(at - camera))), along(dot(point, view)) {
        using std::sqrt;
        const Vec3<T> from = camera - c.centre;
        const T rr = c.radius * c.radius;
        for (int k = 0; k < 3; ++k) off[k] = point[k] - along * view[k];
        inside = dot(from, from) > rr ? T(rr - dot(off, off)) : T(-1);
        if (!(inside > T(0))) return;
        chord = sqrt(inside);
        for (int k = 0; k < 3; ++k) normal[k] = (off[k] - chord * view[k]) / c.radius;
        facing = dot(view, normal);
        rim = constant<T>(0.5) + (c.radius * dot(normal, c.axis) + dot(c.centre, c.axis) - c.rim) /
                                     (c.radius * constant<T>(mirror_rim));
        grazing = inside / (rr * constant<T>(mirror_grazing * mirror_grazing));
    }
};

} // namespace detail

/// Direction that a cornea mirrors to the camera, and the strength of the mirror: 0 where no ray
/// meets it, falling to 0 on the limbus and toward grazing incidence.
template <Scalar T>
struct Mirrored {
    Vec3<T> to; ///< unit length
    T strength; ///< in [0, 1]
};

/// Returns what the cornea mirrors where the camera sees a point through it.
template <Scalar T>
RYE_HD Mirrored<T> mirrored(const Cornea<T>& c, const Vec3<T>& camera, const Vec3<T>& point) {
    const detail::MirrorRay<T> ray(c, camera, point);
    if (!(ray.inside > T(0))) return {Vec3<T>(T(0), T(0), T(0)), T(0)};
    Vec3<T> to;
    for (int k = 0; k < 3; ++k) to[k] = ray.view[k] - T(2) * ray.facing * ray.normal[k];
    return {to, detail::smooth_step(ray.rim) * detail::smooth_step(ray.grazing)};
}

/// Returns the cotangent of the point, given that of what is mirrored; adds the camera's to
/// g_camera.
template <Scalar T>
RYE_HD Vec3<T> mirrored_vjp(const Cornea<T>& c, const Vec3<T>& camera, const Vec3<T>& point,
                            const Mirrored<T>& g, Vec3<T>& g_camera) {
    const detail::MirrorRay<T> ray(c, camera, point);
    if (!(ray.inside > T(0))) return Vec3<T>(T(0), T(0), T(0));
    const T to_normal = dot(g.to, ray.normal);
    const T by_rim = g.strength * detail::smooth_step_slope(ray.rim) *
                     detail::smooth_step(ray.grazing) / constant<T>(detail::mirror_rim);
    T g_inside =
        g.strength * detail::smooth_step(ray.rim) * detail::smooth_step_slope(ray.grazing) /
        (c.radius * c.radius * constant<T>(detail::mirror_grazing * detail::mirror_grazing));
    Vec3<T> g_view, g_off;
    for (int k = 0; k < 3; ++k) {
        g_view[k] = g.to[k] - T(2) * to_normal * ray.normal[k];
        const T g_normal =
            by_rim * c.axis[k] - T(2) * (to_normal * ray.view[k] + ray.facing * g.to[k]);
        g_off[k] = g_normal / c.radius;
        g_view[k] -= ray.chord * g_off[k];
    }
    // chord^2 = inside = R^2 - |off|^2, off = point - along view, along = point . view.
    g_inside -= dot(g_off, ray.view) / (T(2) * ray.chord);
    for (int k = 0; k < 3; ++k) g_off[k] -= T(2) * g_inside * ray.off[k];
    const T g_along = T(0) - dot(g_off, ray.view);
    for (int k = 0; k < 3; ++k) g_view[k] += g_along * ray.point[k] - ray.along * g_off[k];
    const Vec3<T> turned = normalized_vjp(Vec3<T>(point - camera), g_view);
    Vec3<T> g_point;
    for (int k = 0; k < 3; ++k) {
        g_camera[k] -= turned[k];
        g_point[k] = turned[k] + g_off[k] + g_along * ray.view[k];
    }
    return g_point;
}

/// Returns the brightness of a light in a direction: exp((to . light - 1) / width^2), both unit
/// vectors, the width in radians.
template <Scalar T>
RYE_HD T light_lobe(const Vec3<T>& to, const Vec3<T>& light, const T& width) {
    using std::exp;
    return exp((dot(to, light) - T(1)) / (width * width));
}

} // namespace rye
