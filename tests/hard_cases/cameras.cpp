// SPDX-License-Identifier: Apache-2.0
// Positions relative to the camera, and projection (A6-A11, A15-A17).
#include <limits>

#include <rye/autodiff/dual.hpp>
#include <rye/backend/scalar.hpp>
#include <rye/gaussian/project.hpp>
#include <rye/geometry/neighbours.hpp>
#include <rye/rig/eye_transform.hpp>

#include "report.hpp"

namespace rye::hard {
namespace {

template <class R>
Pinhole<R> camera_of(double focal = 1000) {
    Pinhole<R> c;
    c.fx = c.fy = R(focal);
    c.cx = c.cy = R(256);
    c.width = c.height = 512;
    return c;
}
template <class S>
Shape<S> ball(double x, double y, double z, double size = 0.02) {
    using R = real_t<S>;
    const auto to = [](double v) { return S(static_cast<R>(v)); };
    return {Vec3<S>(to(x), to(y), to(z)), Quat<S>(to(0.9), to(0.3), to(-0.1), to(0.2)),
            Vec3<S>(to(size), to(size * 0.4), to(size * 2))};
}
template <class S>
ScreenCotangent<S> some_cotangent() {
    return {Vec2<S>(S(0.3f), S(-0.2f)), {S(0.5f), S(0.1f), S(0.7f)}, S(0.25f)};
}

template <class S>
void a6_a8(Report& report) {
    using R = real_t<S>;
    auto camera = camera_of<R>();
    camera.near_depth = R(0.01);
    const Projector<S> lens(Projector<R>(camera, 0.3, 0.3));
    const double near = first(lens.near_depth), u = unit<S>;
    bool declared = true, dead = true;
    for (const double z : {near * (1 + 4 * u), near, near * (1 - 4 * u), near / 2, 1e-6, 0.0, -1.0,
                           -1e-20, std::nan("")}) {
        const auto s = project(ball<S>(0.001, 0.002, z), lens);
        declared = declared && truth(s.drawable) == (z > near);
        const auto g = project_vjp(ball<S>(0.001, 0.002, z), lens, some_cotangent<S>());
        if (!std::isnan(z))
            for (int k = 0; k < 3; ++k) dead = dead && std::isfinite(first(g.mean[k]));
    }
    report.holds("A6", kind_of<S>(),
                 "z in {near(1 +- u), near/2, 1e-6, 0, -z, NaN}: drawn iff beyond", declared);
    report.holds("A6", kind_of<S>(), "the same: the vjp is finite", dead);
    const R x = R(0.001), zero = R(0);
    report.textbook_fails("A6", kind_of<S>(), "f x / z with no near plane, at z = 0",
                          std::isfinite(R(1000) * x / zero));
    // A8: mean two standard deviations in front, at, behind the plane of the camera.
    bool silent = true;
    for (const double z : {0.0, -0.02, -0.04, -3.0})
        silent = silent && !truth(project(ball<S>(0, 0, z), lens).drawable);
    report.holds("A8", kind_of<S>(), "mean at 0 and behind the camera: nothing is drawn", silent);
    // A splat behind the camera projects to the mirrored place if the sign of z is ignored.
    const double mirrored = 1000 * 0.01 / -2.0;
    report.textbook_fails("A8", kind_of<S>(), "f x / z behind the camera lies outside the image",
                          std::abs(mirrored) > 256);
}

/// Dot-product test of the projection's mean alone, at a given x / z.
double clamp_gap(double slope, double limit_gap_scale, bool doubled) {
    using D = Dual<double, 1>;
    const auto camera = camera_of<double>();
    const double z = 2, x = slope * z;
    const Projector<double> lens(camera, 0.3, 0.3);
    const Projector<D> dual_lens(camera.cast<D>(), 0.3, 0.3);
    auto shape = ball<double>(x, 0.1, z, 0.05);
    Shape<D> dual{shape.mean.cast<D>(), shape.rotation.cast<D>(), shape.scale.cast<D>()};
    const double v[3] = {0.3, -0.2, 0.7};
    for (int k = 0; k < 3; ++k) dual.mean[k].d[0] = v[k];
    const auto s = project(dual, dual_lens);
    // -|w|^2 / 2 at a fixed point one standard deviation away.
    const auto plain = project(shape, lens);
    const double u = 0.8, w = -0.4;
    const double dx = u / plain.precision.k1, dy = w / plain.precision.k2 + plain.precision.m * dx;
    const D ex = D(plain.centre[0] + dx) - s.centre[0], ey = D(plain.centre[1] + dy) - s.centre[1];
    const D e = D(-0.5) * s.precision.quadratic(ex, ey);
    ScreenCotangent<double> g;
    g.centre = Vec2<double>(plain.precision.k1 * u - plain.precision.k2 * plain.precision.m * w,
                            plain.precision.k2 * w);
    g.moment = {u * u, u * w, w * w};
    g.depth = 0;
    auto back = project_vjp(shape, lens, g);
    if (doubled) {
        // The first implementation keeps 2 f t / z^3 where the limit holds t / z fixed: the vjp's
        // result for z, plus once more the part of the clamped slope.
        const double h = 1e-6;
        const auto at = [&](double dz) {
            auto moved = shape;
            moved.mean[2] += dz;
            const auto p = project(moved, lens);
            return -0.5 * p.precision.quadratic(plain.centre[0] + dx - p.centre[0],
                                                plain.centre[1] + dy - p.centre[1]);
        };
        back.mean[2] += 0.5 * (at(h) - at(-h)) / (2 * h) * limit_gap_scale;
    }
    double reverse = 0, scale = 0;
    for (int k = 0; k < 3; ++k) {
        reverse += back.mean[k] * v[k];
        scale += std::abs(back.mean[k] * v[k]);
    }
    return std::abs(e.d[0] - reverse) / scale;
}

void a7(Report& report) {
    const double limit = (256 + 0.3 * 256) / 1000;
    double worst = 0;
    for (const double off : {0.0, 1e-7, 1e-3, 1.0})
        for (const double side : {1.0, -1.0}) {
            worsen(worst, clamp_gap(limit * (1 + side * off), 0, false));
            worsen(worst, clamp_gap(-limit * (1 + side * off), 0, false));
        }
    report.at_most("A7", "double", "x/z = +-limit (1 +- {0, 1e-7, 1e-3, 1}): <Jv, w> = <v, J'w>",
                   1e-13, worst);
    report.textbook("A7", "double", "2 f t / z^3 beyond the limit", 1e-13,
                    clamp_gap(limit * 2, 1, true));
}

template <class S>
void a9_a10_a11(Report& report) {
    using R = real_t<S>;
    // A9: a crop with the margin opened is the same screen Gaussian, bit for bit.
    auto whole = camera_of<R>(), crop = whole;
    crop.cx -= R(300), crop.width = 100;
    const Projector<S> a(Projector<R>(whole, 1e4, 0.3)), b(Projector<R>(crop, 1e4, 0.3));
    const auto shape = ball<S>(0.2, 0.1, 1.5);
    const auto p = project(shape, a), q = project(shape, b);
    report.holds(
        "A9", kind_of<S>(), "principal point outside the crop: same numbers",
        first(p.centre[0]) == first(q.centre[0]) && first(p.precision.k2) == first(q.precision.k2));
    const auto tight = Projector<R>(crop, 0.3, 0.3);
    report.holds("A9", kind_of<S>(), "limits about the image, wherever the principal point is",
                 double(tight.x_high) > 0.144 && double(tight.x_high) < 0.17 &&
                     double(tight.x_low) > 0.0289 && double(tight.x_low) < 0.045);
    // Symmetric limits of 1.3 tan(fov / 2) put this crop's own centre, x/z = 0.094, outside.
    report.textbook_fails("A9", kind_of<S>(), "limits +-1.3 w / (2 f) hold the crop's centre",
                          0.094 <= 1.3 * 100 / 2000);
    // A10
    double worst = 0, biased = 0;
    for (const double z : {0.011, 0.2, 1.0, 1e3})
        for (const double t : {-1.0, 0.0, 1.0}) {
            auto camera = camera_of<R>(2000);
            const Projector<S> lens(Projector<R>(camera, 0.3, 0.3));
            const R zr = static_cast<R>(z), xr = static_cast<R>(t * z);
            const auto s = project(ball<S>(double(xr), 0, double(zr)), lens);
            const double truth = 2000 * double(xr) / double(zr);
            const double scale = 2 * unit<S> * std::max(1e-30, std::abs(truth));
            if (t != 0) worsen(worst, std::abs(first(s.centre[0]) - truth) / scale);
            const R textbook = R(2000) * xr * (R(1) / (zr + R(1e-7)));
            if (t != 0) worsen(biased, std::abs(double(textbook) - truth) / scale);
        }
    report.at_most("A10", kind_of<S>(), "z from near to 1e3, x/z in {0, +-1}: pixel [ulp]", 2,
                   worst);
    report.textbook("A10", kind_of<S>(), "1 / (w + 1e-7) [ulp]", 2, biased);
    // A11: below a pixel the determinant is the dilation's and stays positive.
    bool sound = true;
    for (const double size : {0.0, 1e-8, 1e-6, 1e-3, 3e-4, 3e-3}) {
        const auto s = project(ball<S>(0, 0, 1, size), Projector<S>(Projector<R>(whole, 0.3, 0.3)));
        sound = sound && truth(s.drawable) && first(s.determinant) >= 0.089999;
    }
    report.holds("A11", kind_of<S>(), "sigma 0 to 3 px: drawn, determinant >= d^2", sound);
}

/// Peak of a Gaussian along the ray through a pixel against EWA's, with the model's own bound.
void a15(Report& report) {
    double worst = 0;
    for (const double ratio : {1e-3, 1e-2, 1e-1})
        for (const double slope : {0.0, 0.3, 1.0}) {
            // Isotropic in y, long in z by ratio: mean shift f (x/z) (sigma_z / z)^2.
            const double f = 1000, z = 2, sigma = ratio * z, thin = 1e-3 * z;
            const double shift = f * slope * ratio * ratio;
            // The ray's peak: minimise over t of ((t s - x)/thin)^2 + ((t - z)/sigma)^2 near z.
            const double x = slope * z;
            double best = 0, at = 0;
            for (int i = -2000; i <= 2000; ++i) {
                const double px = f * slope + 3e-3 * shift * i, s = px / f;
                const double a = s * s / (thin * thin) + 1 / (sigma * sigma);
                const double b = s * x / (thin * thin) + z / (sigma * sigma);
                const double t = b / a;
                const double e = std::exp(-0.5 * ((t * s - x) * (t * s - x) / (thin * thin) +
                                                  (t - z) * (t - z) / (sigma * sigma)));
                if (e > best) best = e, at = px;
            }
            worsen(worst, std::abs(at - f * slope) / (shift + 1));
        }
    report.at_most("A15", "double",
                   "sigma/z to 0.1, x/z to 1: peak moves by f (x/z)(s/z)^2 at most", 1, worst);
}

template <class T>
void a16(Report& report) {
    double worst = 0, folded = 0;
    for (const double far : {1.0, 10.0, 1e3, 1e5})
        for (std::uint64_t i = 0; i < 200; ++i) {
            const double p = 0.5 * Random{16, 0}.normal(2 * i),
                         y = 0.5 * Random{16, 1}.normal(2 * i);
            const Vec3<T> gaze = gaze_vector(T(p), T(y));
            const Vec3<T> centre(T(far), T(0.1), T(-far));
            EyeDrive<T> drive{centre, Vec3<T>(T(0), T(0), T(0)), gaze};
            const EyeTransform<T> e = eye_transform(drive, HeadPlacement<T>());
            const Vec3<T> x(T(0.03), T(-0.05), T(0.1));
            const Vec3<T> got = e.apply(x);
            const Vec3<long double> truth =
                quat_matrix(shortest_arc(Vec3<long double>(0, 0, 1),
                                         Vec3<long double>(normalized(Vec3<long double>(
                                             gaze.template cast<long double>()))))) *
                    x.template cast<long double>() +
                centre.template cast<long double>();
            // Points at their places in the head, turned about c by R x + (c - R c).
            const Mat3<T> r = e.rotation;
            const Vec3<T> placed = x + centre, offset = centre - r * centre;
            const Vec3<T> naive = r * placed + offset;
            const double scale = 4 * unit<T> * far;
            for (int k = 0; k < 3; ++k) {
                worsen(worst, std::abs(double(got[k]) - double(truth[k])) / scale);
                worsen(folded, std::abs(double(naive[k]) - double(truth[k])) / scale);
            }
        }
    report.at_most("A16", kind_of<T>(), "eye centre at 1 to 1e5, turned: error in 4u|c|", 0.6,
                   worst);
    if (sizeof(T) == 4) report.textbook("A16", kind_of<T>(), "R x + (c - R c)", 0.6, folded);
}

template <class T>
void a17(Report& report) {
    bool finite = true;
    Columns<T> same = Columns<T>::Constant(3, 5, T(0.25)), one = same.leftCols(1);
    Columns<T> two = same.leftCols(2);
    two(0, 1) = T(1.25);
    const auto d5 = mean_squared_neighbour_distance(ScalarBackend<>{}, same);
    const auto d1 = mean_squared_neighbour_distance(ScalarBackend<>{}, one);
    const auto d2 = mean_squared_neighbour_distance(ScalarBackend<>{}, two);
    finite = d5.isZero(0) && d1(0, 0) == T(0) && d2(0, 0) == T(1);
    report.holds("A17", kind_of<T>(), "5 equal points, 1, 2: squared distances 0, 0, 1", finite);
    report.textbook_fails("A17", kind_of<T>(), "log of the distance, unclamped",
                          std::isfinite(std::log(d5(0, 0))));
}

} // namespace

void cameras(Report& report) {
    every_scalar([&]<class S>() {
        a6_a8<S>(report);
        a9_a10_a11<S>(report);
    });
    a7(report);
    a15(report);
    a16<float>(report);
    a16<double>(report);
    a17<float>(report);
    a17<double>(report);
}

} // namespace rye::hard
