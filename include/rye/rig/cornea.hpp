// SPDX-License-Identifier: Apache-2.0
/// rye/rig/cornea.hpp: optics of a spherical cornea for one eye: refraction displaces the iris, and
/// the reflection of a light, the glint, is added to the colours. Frame: the eyeball's, origin at
/// its centre; lengths in canonical head units; the camera and the lights are points of that frame.
/// Approximations: a Gaussian's centre moves onto its refracted ray, as far behind the cornea along
/// that ray as before; its shape is unchanged. The corneal sphere continues below the sclera. A
/// point whose light is totally reflected on its way to the camera moves to the rim.
/// Source: Fermat's principle (geometry/sphere_path.hpp); radii of Gullstrand's eye.
#pragma once

#include <cmath>

#include <rye/autodiff/dual.hpp>
#include <rye/geometry/sphere_path.hpp>
#include <rye/math/scalar.hpp>

namespace rye {

/// Refractive index of the aqueous humour relative to air (Gullstrand).
inline constexpr double aqueous_index = 1.336;
/// Cosine of the angle of incidence below which a glint fades.
inline constexpr double glint_grazing = 0.1;

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

/// Geometry of a reflection: camera and light in the eyeball's frame, width of the glint [unit].
template <Scalar T>
struct GlintView {
    Vec3<T> camera, light;
    T width;
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

/// Returns the cotangent of the point; adds the camera's to g_camera.
template <Scalar T>
RYE_HD Vec3<T> seen_through_vjp(const RefractingCornea<T>& refracting, const Vec3<T>& camera,
                                const Vec3<T>& point, const Vec3<T>& g, Vec3<T>& g_camera) {
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
                g_camera[k] += g[i] * a[i].d[static_cast<std::size_t>(k)];
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
    const SpherePathCotangent<T> ends =
        sphere_path_vjp(eye, source, {c.radius, index}, path.at, g_at);
    Vec3<T> r;
    for (int i = 0; i < 3; ++i) {
        g_camera[i] += ends.eye[i] - turn[i];
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

/// Arguments to the smooth steps whose product is the strength of a reflection.
template <Scalar T>
struct GlintFades {
    T rim, grazing;

    RYE_HD GlintFades(const Cornea<T>& c, const GlintView<T>& view, const Vec3<T>& at)
        : rim(constant<T>(0.5) + (dot(at, c.axis) - c.rim) / view.width),
          grazing(dot(Vec3<T>(at - c.centre), normalized(Vec3<T>(view.camera - at))) /
                  (c.radius * constant<T>(glint_grazing))) {}
};

} // namespace detail

/// Reflection of a light on the cornea: its point and its strength, which is 0 where the light or
/// the camera cannot see that point, and fades within half a width of the limbus and near grazing.
template <Scalar T>
struct MirrorImage {
    Vec3<T> at;
    T strength;                  ///< in [0, 1]
    bool seen;
};

/// Gradient with respect to a reflection's image, the camera and the light.
template <Scalar T>
struct GlintGradient {
    MirrorImage<T> image;
    Vec3<T> camera, light;
};

/// Returns the image of a point light in the cornea, in the eyeball's frame.
template <Scalar T>
RYE_HD MirrorImage<T> mirror_image(const Cornea<T>& c, const GlintView<T>& view) {
    const Vec3<T> eye = view.camera - c.centre, source = view.light - c.centre;
    const T rr = c.radius * c.radius;
    if (!(dot(eye, eye) > rr && dot(source, source) > rr)) return {c.centre, T(0), false};
    const SpherePath<T> path = sphere_path(eye, source, {c.radius, T(1)});
    const Vec3<T> at = c.centre + path.at;
    if (!path.seen) return {at, T(0), false};
    const detail::GlintFades<T> f(c, view, at);
    const T strength = detail::smooth_step(f.rim) * detail::smooth_step(f.grazing);
    return {at, strength, strength > T(0)};
}

/// Adds the cotangents of camera and light to g; g.image holds the cotangent of the image.
template <Scalar T>
RYE_HD void mirror_image_vjp(const Cornea<T>& c, const GlintView<T>& v, const MirrorImage<T>& m,
                             GlintGradient<T>& g) {
    if (!m.seen) return;
    const detail::GlintFades<T> f(c, v, m.at);
    const T by_rim = g.image.strength * detail::smooth_step_slope(f.rim) *
                     detail::smooth_step(f.grazing) / v.width;
    const T by_grazing = g.image.strength * detail::smooth_step(f.rim) *
                         detail::smooth_step_slope(f.grazing) /
                         (c.radius * constant<T>(glint_grazing));
    const Vec3<T> view = v.camera - m.at, toward = normalized(view);
    const Vec3<T> g_view = normalized_vjp(view, Vec3<T>((m.at - c.centre) * by_grazing));
    Vec3<T> g_at;
    for (int i = 0; i < 3; ++i)
        g_at[i] = g.image.at[i] + by_rim * c.axis[i] + by_grazing * toward[i] - g_view[i];
    const SpherePathCotangent<T> ends =
        sphere_path_vjp(Vec3<T>(v.camera - c.centre), Vec3<T>(v.light - c.centre),
                        {c.radius, T(1)}, Vec3<T>(m.at - c.centre), g_at);
    g.camera += g_view + ends.eye;
    g.light += ends.source;
}

/// Returns the brightness of a reflection at a point: strength exp(-d^2 / 2 width^2), where d is
/// the distance of the point from the camera's ray through the image.
template <Scalar T>
RYE_HD T glint_at(const MirrorImage<T>& m, const GlintView<T>& v, const Vec3<T>& point) {
    using std::exp;
    const Vec3<T> d = normalized(Vec3<T>(m.at - v.camera)), r = point - m.at;
    const Vec3<T> off = r - d * dot(d, r);
    return m.strength * exp(constant<T>(-0.5) * dot(off, off) / (v.width * v.width));
}

/// Returns the cotangent of the point; adds the image's and the camera's to g. `g_log` is the
/// cotangent of the value's logarithm: the value's cotangent times the value.
template <Scalar T>
RYE_HD Vec3<T> glint_at_vjp(const MirrorImage<T>& m, const GlintView<T>& v, const Vec3<T>& point,
                            const T& g_log, GlintGradient<T>& g) {
    const Vec3<T> view = m.at - v.camera, d = normalized(view), r = point - m.at;
    const T along = dot(d, r);
    const T k = T(0) - g_log / (v.width * v.width);
    g.image.strength += g_log / m.strength;
    // |off|^2 = |r|^2 - (d r)^2.
    const Vec3<T> g_r = (r - d * along) * k;
    const Vec3<T> g_view = normalized_vjp(view, Vec3<T>(r * (T(0) - along * k)));
    g.image.at += g_view - g_r;
    g.camera -= g_view;
    return g_r;
}

} // namespace rye
