// SPDX-License-Identifier: Apache-2.0
/// rye/geometry/distortion.hpp: lens distortion as a policy of the camera; a pinhole's is empty.
/// Slopes s = (x/z, y/z) in the camera frame, dimensionless, become D(s), which the focal lengths
/// scale to pixels: u = fx D(s).x + cx.
///     D(s) = s (1 + k1 r^2 + k2 r^4 + k3 r^6) + tangential, r = |s|
/// D is one-to-one up to the smallest r at which the radial part turns back (the fold), and where
/// the determinant of its Jacobian is positive. Points beyond are culled.
/// Source: Brown, "Decentering Distortion of Lenses", 1966; signs and order of p1 and p2 as in
/// OpenCV, COLMAP's OPENCV model and transforms.json.
#pragma once

#include <cmath>
#include <concepts>

#include <rye/math/linalg.hpp>

namespace rye {

/// A distorted slope D(s), and the Jacobian of D, which is symmetric.
template <Scalar T>
struct Distorted {
    Vec2<T> at;
    Sym2<T> slope;
};

/// Lens without distortion.
struct NoDistortion {
    static constexpr bool distorts = false;
    template <Scalar U>
    RYE_HD NoDistortion cast() const {
        return {};
    }
};

/// Radial and tangential distortion: k1, k2, k3, p1, p2 of OpenCV.
template <Scalar T>
struct BrownConrady {
    static constexpr bool distorts = true;
    using scalar = T;

    T k1 = T(0), k2 = T(0), k3 = T(0);             ///< radial, of r^2, r^4, r^6
    T p1 = T(0), p2 = T(0);                        ///< tangential

    RYE_HD Distorted<T> distort(const Vec2<T>& s) const {
        const T x = s[0], y = s[1], t = x * x + y * y, two = T(2), six = T(6);
        const T radial = T(1) + t * (k1 + t * (k2 + t * k3));
        const T rate = k1 + t * (two * k2 + T(3) * t * k3);               // d radial / d t
        return {Vec2<T>(x * radial + two * p1 * x * y + p2 * (t + two * x * x),
                        y * radial + p1 * (t + two * y * y) + two * p2 * x * y),
                {radial + two * x * x * rate + two * p1 * y + six * p2 * x,
                 two * x * y * rate + two * p1 * x + two * p2 * y,
                 radial + two * y * y * rate + six * p1 * y + two * p2 * x}};
    }

    /// Returns the cotangent of s, given that of the Jacobian's stored numbers.
    RYE_HD Vec2<T> slope_vjp(const Vec2<T>& s, const Sym2<T>& g) const {
        const T x = s[0], y = s[1], t = x * x + y * y, two = T(2), four = T(4), six = T(6);
        const T rate = k1 + t * (two * k2 + T(3) * t * k3);
        const T bow = two * k2 + six * t * k3;                            // d rate / d t
        const T xxx = six * x * rate + four * x * x * x * bow + six * p2;
        const T xxy = two * y * rate + four * x * x * y * bow + two * p1;
        const T xyy = two * x * rate + four * x * y * y * bow + two * p2;
        const T yyy = six * y * rate + four * y * y * y * bow + six * p1;
        return Vec2<T>(g.xx * xxx + g.xy * xxy + g.yy * xyy,
                       g.xx * xxy + g.xy * xyy + g.yy * yyy);
    }

    /// Returns r^2 of the fold; infinite if the radial part never turns back. Without derivative.
    RYE_HD real_t<T> fold() const {
        using R = real_t<T>;
        // d(r D)/dr = 1 + 3 k1 t + 5 k2 t^2 + 7 k3 t^3: its first root, between turning points.
        const double a = 3 * number(k1), b = 5 * number(k2), c = 7 * number(k3);
        const auto rise = [&](double t) { return 1 + t * (a + t * (b + t * c)); };
        double ends[3]{0, 0, 0};
        const double root = b * b - 3 * a * c;
        if (root >= 0) {  // roots of a + 2 b t + 3 c t^2 without cancellation
            const double q = -(b + std::copysign(std::sqrt(root), b));
            ends[0] = c != 0 ? q / (3 * c) : 0;
            ends[1] = q != 0 ? a / q : 0;
        }
        ends[2] = 1;
        while (ends[2] < 1e12 && rise(ends[2]) > 0) ends[2] *= 2;
        for (double& t : ends)
            if (!(t > 0)) t = 0;
        for (const int k : {0, 1, 0})                                     // in ascending order
            if (ends[k + 1] < ends[k]) {
                const double larger = ends[k];
                ends[k] = ends[k + 1];
                ends[k + 1] = larger;
            }
        double low = 0;
        for (double high : ends) {
            if (rise(high) > 0) {
                low = high;
                continue;
            }
            for (int k = 0; k < 200 && low < high; ++k) {
                const double middle = low + 0.5 * (high - low);
                (rise(middle) > 0 ? low : high) = middle;
                if (std::nextafter(low, high) >= high) break;
            }
            return static_cast<R>(low);
        }
        return Limits<R>::infinity;
    }

    template <Scalar U>
    RYE_HD BrownConrady<U> cast() const {
        const auto to = [](const T& x) { return static_cast<U>(x); };
        return {to(k1), to(k2), to(k3), to(p1), to(p2)};
    }
    /// Returns the same lens in double, without derivatives.
    RYE_HD BrownConrady<double> values() const {
        return {number(k1), number(k2), number(k3), number(p1), number(p2)};
    }

  private:
    RYE_HD static double number(const T& x) { return static_cast<double>(value_of(x)); }
};

/// Lens policy of a camera: NoDistortion, or a type with the distorted slope, the cotangent of its
/// Jacobian, and the fold, up to which it is valid.
template <class D>
concept Distortion =
    std::same_as<D, NoDistortion> ||
    (D::distorts && requires(const D d, Vec2<typename D::scalar> s, Sym2<typename D::scalar> g) {
        { d.distort(s) } -> std::same_as<Distorted<typename D::scalar>>;
        { d.slope_vjp(s, g) } -> std::same_as<Vec2<typename D::scalar>>;
        { d.fold() } -> std::convertible_to<real_t<typename D::scalar>>;
        { d.values().fold() } -> std::same_as<double>;
    });
static_assert(Distortion<NoDistortion> && Distortion<BrownConrady<float>> &&
              !Distortion<Distorted<float>>);

/// Returns true if the lens is valid at a slope: before its fold, at a positive determinant.
template <Scalar T>
RYE_HD auto within_lens(const Vec2<T>& s, const Sym2<T>& slope, const T& fold) {
    return (s[0] * s[0] + s[1] * s[1] < fold) && (slope.determinant() > T(0));
}

/// Result of undistort.
template <Scalar T>
struct Undistorted {
    Vec2<T> slope;
    bool reached;                ///< true if a slope before the fold solves D(slope) = at
};

/// Solves D(s) = at by damped Newton steps from within the fold, on values; the last step carries
/// the derivatives.
template <Distortion D, Scalar T>
RYE_HD Undistorted<T> undistort(const D& lens, const Vec2<T>& at) {
    using R = real_t<T>;
    const auto value = [](const T& x) { return static_cast<double>(value_of(x)); };
    const auto exact = lens.values();
    const double reach = std::sqrt(exact.fold());
    const Vec2<double> goal(value(at[0]), value(at[1]));
    Vec2<double> s = goal;
    if (s.norm() >= reach) s *= 0.9 * reach / s.norm();
    const double close = 1e-14 * (1 + goal.norm());
    Distorted<double> b = exact.distort(s);
    for (int k = 0; k < 60; ++k) {
        const Vec2<double> miss(goal - b.at);
        const double det = b.slope.determinant(), far = miss.norm();
        if (far <= close || !(det > 0)) break;
        const Vec2<double> step((b.slope.yy * miss[0] - b.slope.xy * miss[1]) / det,
                                (b.slope.xx * miss[1] - b.slope.xy * miss[0]) / det);
        // Halves the step until it stays within the fold and reduces the residual.
        double part = 1;
        Vec2<double> to(s + step);
        Distorted<double> c = exact.distort(to);
        for (int h = 0; h < 50 && !(to.norm() < reach && (goal - c.at).norm() < far); ++h) {
            part *= 0.5;
            to = s + part * step;
            c = exact.distort(to);
        }
        if (!((goal - c.at).norm() < far)) break;
        s = to;
        b = c;
    }
    const bool reached = (goal - b.at).norm() <= 100 * close &&
                         within_lens(s, b.slope, reach * reach);
    const Vec2<T> from(T(static_cast<R>(s[0])), T(static_cast<R>(s[1])));
    const Distorted<T> c = lens.distort(from);
    const T x = at[0] - c.at[0], y = at[1] - c.at[1], det = c.slope.determinant();
    return {Vec2<T>(from[0] + (c.slope.yy * x - c.slope.xy * y) / det,
                    from[1] + (c.slope.xx * y - c.slope.xy * x) / det),
            reached};
}

} // namespace rye
