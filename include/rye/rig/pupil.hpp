// SPDX-License-Identifier: Apache-2.0
/// rye/rig/pupil.hpp: an iris whose pupil is wider or narrower than at rest: its points move along
/// radii, between the pupil's edge and the limbus, which stays. Frame: the eyeball's, origin at its
/// centre, iris toward +z; lengths in canonical head units.
/// At a distance r from the axis, with the pupil's radius p at rest, its ratio s and the limbus'
/// radius l, a point comes to f(r) = s r for r <= p, linearly from s p to l for p <= r <= l, and
/// stays beyond. It keeps to the paraboloid of the iris (rig/eyeball.hpp).
/// Approximations: a Gaussian keeps its orientation, and its two axes along the surface grow by
/// sqrt(f'(r) f(r) / r), so that its area grows as the surface does; within the pupil that is
/// exact, on the iris f'(r) belongs to the radius and f(r) / r across it. The radius at rest is the
/// limbus' times that of EyeballShape, whatever is painted on the iris.
/// Source: the linear stretch is that of Daugman, "High confidence visual recognition of persons by
/// a test of statistical independence", 1993.
#pragma once

#include <cmath>

#include <rye/core/columns.hpp>
#include <rye/core/error.hpp>
#include <rye/core/format.hpp>
#include <rye/math/scalar.hpp>
#include <rye/rig/eyeball.hpp>

namespace rye {

/// Least and most ratio of a pupil's radius to that at rest.
inline constexpr double least_pupil = 0.4, most_pupil = 2;

/// An iris in its eyeball's frame; the zero iris has no points.
template <Scalar T>
struct Iris {
    T pupil = T(0);  ///< radius of the pupil at rest [unit]
    T limbus = T(0); ///< radius of the limbus, above pupil [unit]
    T rise = T(0);   ///< z of the limbus minus that of the middle [unit]
};

/// The iris of an eyeball whose points are those of a template, 3 x P: all points of its front
/// within the limbus lie off the sphere. It ends a ten-thousandth within the limbus, whose points
/// stay as they are, however they are rounded. Its pupil has that radius times the default
/// EyeballShape's. Without such points, or without a limbus on the sphere, the zero iris.
template <Scalar T>
Iris<T> iris_of_points(const ColumnsView<T>& points) {
    Iris<T> iris;
    if (points.cols() == 0) return iris;
    Index back = 0;
    for (Index i = 1; i < points.cols(); ++i)
        if (points(2, i) < points(2, back)) back = i;
    const T radius = norm(Vec3<T>(points.col(back)));
    const auto on_sphere = [&](Index i) {
        const T apart = norm(Vec3<T>(points.col(i))) - radius;
        return apart < radius * constant<T>(1e-3) && apart > radius * constant<T>(-1e-3);
    };
    const auto square = [&](Index i) {
        return points(0, i) * points(0, i) + points(1, i) * points(1, i);
    };
    Index middle = -1, limbus = -1;
    T within = T(0);
    for (Index i = 0; i < points.cols(); ++i)
        if (points(2, i) > T(0) && !on_sphere(i)) {
            if (middle < 0 || square(i) < square(middle)) middle = i;
            if (square(i) > within) within = square(i);
        }
    for (Index i = 0; i < points.cols(); ++i)
        if (points(2, i) > T(0) && on_sphere(i) && square(i) > within &&
            (limbus < 0 || square(i) < square(limbus)))
            limbus = i;
    if (middle < 0 || limbus < 0) return iris;
    using std::sqrt;
    const BasicEyeballShape<PaperEffects> usual;
    iris.limbus = sqrt(square(limbus)) * constant<T>(1 - 1e-4);
    iris.pupil = iris.limbus * constant<T>(usual.pupil_radius / usual.limbus_radius);
    iris.rise = points(2, limbus) - points(2, middle);
    return iris;
}

/// Motion of an eyeball's points with its pupil. A ratio of 1 changes no bit. Its derivatives are
/// those of duals: what it moves, and the ratio, are not trained.
template <Scalar T>
struct PupilMap {
    Iris<T> iris;
    T ratio = T(1);

    /// Returns the point, moved.
    RYE_HD Vec3<T> operator()(const Vec3<T>& p) const {
        if (!inside(p)) return p;
        const T rr = p[0] * p[0] + p[1] * p[1], by = T(1) + widening(rr);
        const T share = (by * by - T(1)) * rr / (iris.limbus * iris.limbus);
        return Vec3<T>(p[0] * by, p[1] * by, p[2] + iris.rise * share);
    }
    /// Returns what the axes along the surface of a Gaussian there grow by.
    RYE_HD T stretch(const Vec3<T>& p) const {
        if (!inside(p)) return T(1);
        using std::sqrt;
        const T rr = p[0] * p[0] + p[1] * p[1], by = T(1) + widening(rr);
        if (rr <= iris.pupil * iris.pupil) return by;
        return sqrt(by * (T(1) - (ratio - T(1)) * iris.pupil / (iris.limbus - iris.pupil)));
    }

  private:
    RYE_HD bool inside(const Vec3<T>& p) const {
        return p[2] > T(0) && p[0] * p[0] + p[1] * p[1] < iris.limbus * iris.limbus;
    }
    /// f(r) / r - 1 by r^2 within the limbus.
    RYE_HD T widening(const T& rr) const {
        using std::sqrt;
        const T more = ratio - T(1);
        if (rr <= iris.pupil * iris.pupil) return more;
        const T r = sqrt(rr);
        return more * (iris.pupil * (iris.limbus - r) / (r * (iris.limbus - iris.pupil)));
    }
};

/// Returns the map of an eye (0: the subject's left). Throws an Error for a ratio that is not
/// finite, not from least_pupil to most_pupil, or that would move the pupil over the limbus, and
/// for the zero iris with another ratio than 1.
template <Scalar T>
PupilMap<T> pupil_map(std::size_t eye, const Iris<T>& iris, const T& ratio) {
    const double s = static_cast<double>(value_of(ratio));
    require(s >= least_pupil && s <= most_pupil, "pupil", "got the ratio ",
            [&] { return number_text(s); }, " for the ", eye == 0 ? "left" : "right",
            " eye, expected ", least_pupil, " to ", most_pupil, ", 1 at rest");
    require(s == 1 || iris.limbus > T(0), "pupil", "the points of the ",
            eye == 0 ? "left" : "right",
            " eye have no iris apart from a sphere, expected those of eyeball_template");
    require(iris.pupil * ratio < iris.limbus || s == 1, "pupil", "got the ratio ",
            [&] { return number_text(s); }, ", at which the ", eye == 0 ? "left" : "right",
            " pupil reaches the limbus");
    return {iris, ratio};
}

} // namespace rye
