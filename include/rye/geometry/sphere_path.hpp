// SPDX-License-Identifier: Apache-2.0
/// rye/geometry/sphere_path.hpp: the point where light from a source to an eye crosses a sphere
/// about the origin: by refraction (source inside, Snell's law) or by reflection (source outside,
/// Alhazen's problem). Both are the stationary point Q of the optical path
///     L(Q) = n |Q - P| + |Q - C|,   |Q| = R,
/// with C the eye, P the source, n the source's refractive index over the eye's (1 for a mirror). Q
/// lies in the plane of C, P and the origin, between their directions, so with a = C / |C|
///     Q ~ (1 - w) R a + w s P,   w in [0, 1],   s = 1 inside, R / |P| outside,
/// without a direction across the plane, so an eye on the axis, where there is none, is no special
/// case. Lengths in any one unit.
/// Source: Fermat's principle; the derivative is that of implicit functions.
#pragma once

#include <cmath>
#include <type_traits>

#include <rye/math/linalg.hpp>

namespace rye {

/// Point at which the sphere refracts or reflects light, if there is one.
template <Scalar T>
struct SpherePath {
    Vec3<T> at;                  ///< Q
    bool seen;                   ///< false if no light takes this way; then Q is on the rim
};

namespace detail {

template <Scalar T>
struct PathPoint {
    Vec3<T> at;
    T eye, source;               ///< |Q - C|, |Q - P|
    T balance;                   ///< 0 if the path is stationary; decreases with w
    T slope;                     ///< d balance / dw
};

template <Scalar T>
struct PathPlane {
    Vec3<T> eye, source, toward; ///< C, P, s P
    Vec3<T> ahead;               ///< R a
    T distance, stretch;         ///< |C|, s
    T radius, index;

    RYE_HD PathPlane(const Vec3<T>& c, const Vec3<T>& p, const T& r, const T& n)
        : eye(c), source(p), distance(norm(c)), radius(r), index(n) {
        const T far = norm(p);
        stretch = far < r ? T(1) : T(r / far);
        for (int i = 0; i < 3; ++i) {
            toward[i] = stretch * p[i];
            ahead[i] = c[i] * (r / distance);
        }
    }

    RYE_HD PathPoint<T> at(const T& w) const {
        Vec3<T> v, along;
        for (int i = 0; i < 3; ++i) {
            v[i] = (T(1) - w) * ahead[i] + w * toward[i];
            along[i] = toward[i] - ahead[i];
        }
        PathPoint<T> p;
        const T m = norm(v), scale = radius / (m > T(0) ? m : T(1));
        for (int i = 0; i < 3; ++i) p.at[i] = v[i] * scale;
        const Vec3<T> from_eye = p.at - eye, from_source = p.at - source;
        p.eye = norm(from_eye);
        p.source = norm(from_source);
        const T near = index * radius * (T(1) - w), far = distance * stretch * w;
        p.balance = near * p.eye - far * p.source;
        // dQ/dw = scale (along - Q (Q . along) / R^2).
        const T radial = dot(p.at, along) / (radius * radius);
        T eye_rate(0), source_rate(0);
        for (int i = 0; i < 3; ++i) {
            const T step = scale * (along[i] - p.at[i] * radial);
            eye_rate += from_eye[i] * step;
            source_rate += from_source[i] * step;
        }
        const T safe = p.source > T(0) ? p.source : T(1);
        p.slope = near * (eye_rate / p.eye) - index * radius * p.eye -
                  distance * stretch * p.source - far * (source_rate / safe);
        return p;
    }

    /// Returns w of the sphere's rim as seen from the eye, on the side of the source; at most 1.
    RYE_HD T rim() const {
        using std::sqrt;
        const T a = dot(ahead, toward) / radius;                // along the eye's direction
        Vec3<T> across;
        for (int i = 0; i < 3; ++i) across[i] = toward[i] - ahead[i] * (a / radius);
        const T b = norm(across);
        // Straight behind the origin: w stays below the value at which the direction flips.
        if (!(b > T(Limits<real_t<T>>::epsilon) * radius))
            return a < T(0) ? T(constant<T>(0.9) * radius / (radius - a)) : T(1);
        const T steep = sqrt((distance - radius) * (distance + radius)) / radius;
        return b > steep * a ? T(steep * radius / (b + steep * (radius - a))) : T(1);
    }
};

/// Sphere about the origin, and the refractive index of its inside over the eye's (1: a mirror).
template <Scalar T>
struct OpticalSphere {
    T radius, index;
};

} // namespace detail

/// Returns the path from a source to an eye by way of the sphere. The eye must be outside. Uses a
/// bracketed Newton's method on values; a final step carries the derivatives.
template <Scalar T>
RYE_HD SpherePath<T> sphere_path(const Vec3<T>& eye, const Vec3<T>& source,
                                 const detail::OpticalSphere<std::type_identity_t<T>>& sphere) {
    using R = real_t<T>;
    const T &radius = sphere.radius, &index = sphere.index;
    const auto values = [](const Vec3<T>& x) {
        return Vec3<R>(R(value_of(x[0])), R(value_of(x[1])), R(value_of(x[2])));
    };
    const detail::PathPlane<R> plane(values(eye), values(source), R(value_of(radius)),
                                     R(value_of(index)));
    const detail::PathPlane<T> exact(eye, source, radius, index);
    R low(0), high = plane.rim();
    if (high < R(1) && plane.at(high).balance > R(0)) return {exact.at(exact.rim()).at, false};
    R w = high;
    for (int k = 0; k < 100; ++k) {
        const detail::PathPoint<R> p = plane.at(w);
        if (p.balance == R(0) || p.source == R(0)) break;
        (p.balance > R(0) ? low : high) = w;
        R next = w - p.balance / p.slope;
        if (!(next > low && next < high)) next = low + R(0.5) * (high - low);
        const R step = std::abs(next - w);
        w = next;
        if (step <= R(2) * Limits<R>::epsilon * w) break;
    }
    const detail::PathPoint<R> p = plane.at(w);
    // The source of a reflection is visible only from outside the tangent plane.
    const R rr = plane.radius * plane.radius;
    const bool outside = dot(plane.source, plane.source) >= rr;
    const bool seen = !outside || dot(plane.source, p.at) > rr;
    T last(w);
    if (p.source > R(0)) last = last - (exact.at(T(w)).balance) / T(p.slope);
    return {exact.at(last).at, seen};
}

namespace detail {

/// Cotangents of both ends of a path, and of the index.
template <Scalar T>
struct SpherePathCotangent {
    Vec3<T> eye, source;
    T index;
};

/// Returns the cotangents of a visible path, given that of its point Q, `at`. With the
/// Hessian H of L on the sphere, dQ = -H^-1 (d grad L); H is kept times |Q - P|, which stays finite
/// for a source at the surface.
template <Scalar T>
RYE_HD SpherePathCotangent<T> sphere_path_vjp(const Vec3<T>& eye, const Vec3<T>& source,
                                              const OpticalSphere<std::type_identity_t<T>>& sphere,
                                              const Vec3<T>& at, const Vec3<T>& g) {
    using std::abs;
    const T &radius = sphere.radius, &index = sphere.index;
    const Vec3<T> from_eye = at - eye, from_source = at - source;
    const T dc = norm(from_eye), dp = norm(from_source);
    const Vec3<T> uc = from_eye / dc, up = normalized(from_source), normal = at / radius;
    const T pull = (index * dot(up, normal) + dot(uc, normal)) / radius;
    // A basis of the tangent plane, from the coordinate axis least along the normal.
    Vec3<T> axis(T(0), T(0), T(0));
    int least = 0;
    for (int i = 1; i < 3; ++i)
        if (abs(normal[i]) < abs(normal[least])) least = i;
    axis[least] = T(1);
    const Vec3<T> t = normalized(cross(normal, axis)), b = cross(normal, t);
    const auto form = [&](const Vec3<T>& x, const Vec3<T>& y, const T& same) {
        return index * (same - dot(up, x) * dot(up, y)) +
               dp * ((same - dot(uc, x) * dot(uc, y)) / dc - pull * same);
    };
    const Sym2<T> h{form(t, t, T(1)), form(t, b, T(0)), form(b, b, T(1))};
    const T gt = dot(g, t), gb = dot(g, b), det = h.determinant();
    const T yt = (h.yy * gt - h.xy * gb) / det, yb = (h.xx * gb - h.xy * gt) / det;
    const Vec3<T> y = t * yt + b * yb;                                    // over dp
    const T along_p = dot(up, y), along_c = dot(uc, y);
    SpherePathCotangent<T> r;
    r.index = T(0) - dp * along_p;
    for (int i = 0; i < 3; ++i) {
        r.source[i] = index * (y[i] - up[i] * along_p);
        r.eye[i] = dp / dc * (y[i] - uc[i] * along_c);
    }
    return r;
}

} // namespace detail

} // namespace rye
