// SPDX-License-Identifier: Apache-2.0
/// synthetic_capture/head_sculpt.hpp: the procedural head as a solid: a smooth union of rounded
/// primitives. Head frame and units of head_model.hpp. Values are lower bounds of the signed
/// distance to the surface, negative inside, as sphere tracing needs.
/// Source: Quilez, "Smooth minimum" and "Ellipsoid bound", 2013; the primitives are placed by hand.
#pragma once

#include <algorithm>
#include <cmath>

#include <rye/core/columns.hpp>
#include <rye/math/linalg.hpp>

namespace rye::trainer {

/// Differences of this subject from the mean head; every field is near 0, in head units.
struct HeadShape {
    double width = 0; ///< of the skull
    double jaw_width = 0;
    double chin_length = 0; ///< downwards
    double chin_forward = 0;
    double cheek = 0;        ///< outwards
    double brow_ridge = 0;   ///< forwards
    double nose_length = 0;  ///< of the tip, forwards
    double nose_width = 0;   ///< of the wings
    double nose_bridge = 0;  ///< forwards
    double lip_fullness = 0; ///< forwards
};

namespace sculpt {

/// min(a, b), smoothed within k of equality.
inline double join(double a, double b, double k) {
    const double h = std::max(k - std::abs(a - b), 0.0) / k;
    return std::min(a, b) - h * h * k * 0.25;
}
/// a without b.
inline double carve(double a, double b, double k) { return -join(-a, b, k); }

inline double ellipsoid(const Vec3<double>& p, const Vec3<double>& centre,
                        const Vec3<double>& radii) {
    const Vec3<double> q = p - centre;
    const double near = q.cwiseQuotient(radii).norm();
    const double slope = q.cwiseQuotient(radii.cwiseProduct(radii)).norm();
    return slope > 0 ? near * (near - 1) / slope : -radii.minCoeff();
}

/// A rod from a to b whose radius goes from ra to rb.
inline double rod(const Vec3<double>& p, const Vec3<double>& a, const Vec3<double>& b, double ra,
                  double rb) {
    const Vec3<double> ab = b - a;
    const double t = std::clamp((p - a).dot(ab) / ab.squaredNorm(), 0.0, 1.0);
    return (p - a - t * ab).norm() - (ra + t * (rb - ra));
}

} // namespace sculpt

/// Distance to the closed skin: lids and lips closed, without ears and hair.
inline double head_distance(const Vec3<double>& at, const HeadShape& s) {
    using namespace sculpt;
    using V = Vec3<double>;
    const V p(std::abs(at.x()), at.y(), at.z()); // symmetric

    double d = ellipsoid(p, V(0, 0.66, 0.08), V(0.77 + s.width, 0.82, 0.93));         // skull
    d = join(d, ellipsoid(p, V(0, 0.70, 0.42), V(0.66 + s.width, 0.52, 0.60)), 0.20); // forehead
    d = join(d, ellipsoid(p, V(0, 0.02, 0.34), V(0.66, 0.60, 0.60)), 0.25);           // face
    d = join(d,
             rod(p, V(0.50 + s.jaw_width, -0.26, 0.30),
                 V(0.14, -0.56 - s.chin_length, 0.84 + s.chin_forward), 0.15, 0.13),
             0.22);
    d = join(d, ellipsoid(p, V(0, -0.26, 0.72), V(0.36, 0.34, 0.36)), 0.20); // muzzle
    d = join(
        d, ellipsoid(p, V(0, -0.575 - s.chin_length, 0.91 + s.chin_forward), V(0.19, 0.145, 0.135)),
        0.13); // chin
    d = join(d, ellipsoid(p, V(0.40, 0.06, 0.66), V(0.24 + s.cheek, 0.26, 0.26 + s.cheek)), 0.18);
    d = join(d, rod(p, V(0.07, 0.555, 0.99 + s.brow_ridge), V(0.50, 0.56, 0.80), 0.085, 0.09),
             0.16);                                                                   // brows
    d = join(d, rod(p, V(0, -0.25, -0.08), V(0, -1.55, -0.20), 0.50, 0.53), 0.28);    // neck
    d = join(d, rod(p, V(0, -1.95, -0.22), V(1.05, -2.10, -0.26), 0.46, 0.38), 0.55); // shoulders
    d = join(d, ellipsoid(p, V(0, -2.55, -0.10), V(1.15, 0.80, 0.52)), 0.30);         // chest

    // Hollows beside the nose's root, and under the lower lip.
    d = carve(d, ellipsoid(p, V(0.25, 0.36, 1.06), V(0.15, 0.12, 0.13)), 0.12);
    d = carve(d, ellipsoid(p, V(0.46, 0.33, 1.00), V(0.14, 0.10, 0.10)), 0.12);
    d = carve(d, ellipsoid(p, V(0, -0.475, 1.16), V(0.20, 0.035, 0.085)), 0.10);
    // The closed lids over the eyeball.
    d = join(d, (p - V(0.32, 0.35, 0.79)).norm() - 0.178, 0.06);

    // The nose last, so that smoothing does not blur its edges.
    const double tip = 1.205 + s.nose_length, bridge = s.nose_bridge;
    double n = rod(p, V(0, 0.44, 0.985 + bridge), V(0, 0.05, tip - 0.02), 0.062, 0.080);
    n = join(n, rod(p, V(0, 0.44, 0.86), V(0, 0.00, 0.98), 0.085, 0.120), 0.06); // its root
    n = join(n, ellipsoid(p, V(0, 0.025, tip), V(0.088, 0.080, 0.088)), 0.05);
    n = join(n, ellipsoid(p, V(0.098 + s.nose_width, -0.030, 1.095), V(0.058, 0.064, 0.085)), 0.05);
    n = join(n, rod(p, V(0, -0.02, tip - 0.02), V(0, -0.085, 1.10), 0.035, 0.04), 0.05);
    d = join(d, n, 0.075);
    d = carve(d, ellipsoid(p, V(0.052, -0.083, 1.155), V(0.026, 0.030, 0.050)), 0.03); // nostrils
    // The groove between nose and mouth, and the folds beside it.
    d = carve(d, rod(p, V(0, -0.12, 1.155), V(0, -0.215, 1.165), 0.022, 0.026), 0.04);
    return d;
}

} // namespace rye::trainer
