// SPDX-License-Identifier: Apache-2.0
// Needles on the screen: determinants, exponents, covariances (A1-A5, A12-A14, A18).
#include <limits>

#include <rye/autodiff/dual.hpp>
#include <rye/gaussian/project.hpp>

#include "report.hpp"

namespace rye::hard {
namespace {

constexpr double lengths[] = {10, 100, 1000, 3000, 1e4, 3e4};

/// Rows of a factor with standard deviations (sigma, thin) px at an angle.
template <class S>
void needle(double sigma, double thin, double angle, Vec3<S>& x, Vec3<S>& y) {
    using R = real_t<S>;
    const auto to = [](double v) { return S(static_cast<R>(v)); };
    const double c = std::cos(angle), s = std::sin(angle);
    x = Vec3<S>(to(c * sigma), to(-s * thin), S(R(0)));
    y = Vec3<S>(to(s * sigma), to(c * thin), S(R(0)));
}

/// x cross y, |x|^2, |y|^2 of the given numbers, in long double.
template <class S>
long double exact_determinant(const Vec3<S>& x, const Vec3<S>& y, double d) {
    long double n[2][3], xx = d, yy = d;
    for (int i = 0; i < 3; ++i) {
        n[0][i] = first(x[i]), n[1][i] = first(y[i]);
        xx += n[0][i] * n[0][i], yy += n[1][i] * n[1][i];
    }
    long double cc = 0;
    for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        const long double c = n[0][j] * n[1][k] - n[0][k] * n[1][j];
        cc += c * c;
    }
    return cc + d * (xx + yy - 2 * d) + static_cast<long double>(d) * d;
}

template <class S>
void a1(Report& report) {
    using R = real_t<S>;
    double worst = 0, naive = 0;
    bool positive = true;
    const S d(static_cast<R>(0.3));
    for (const double sigma : lengths)
        for (std::uint64_t i = 0; i < 4000; ++i) {
            Vec3<S> x, y;
            needle(sigma, 1e-3, 6.2831853 * Random{1, 0}.uniform(i), x, y);
            const double det = first(detail::gram_determinant(x, y, d));
            const auto truth = exact_determinant(x, y, static_cast<double>(R(0.3)));
            positive = positive && det > 0;
            worsen(worst, static_cast<double>(std::abs(det / truth - 1)));
            const double plain = first(detail::gram(x, y, d).determinant());
            worsen(naive, static_cast<double>(std::abs(plain / truth - 1)));
        }
    const double demanded = sizeof(R) == 4 ? 4e-7 : 4e-15;
    const char* inputs = "sigma 10 to 3e4 px, other axes 1e-3, 4000 angles each; relative error";
    report.at_most("A1", kind_of<S>(), inputs, demanded, worst);
    report.holds("A1", kind_of<S>(), "the same needles: the determinant is positive", positive);
    report.textbook("A1", kind_of<S>(), "a c - b^2", demanded, naive);
}

template <class S>
void a2(Report& report) {
    using R = real_t<S>;
    double worst = 0, conic_worst = 0, alpha = 0, conic_alpha = 0;
    bool negative = true;
    const double sigma = 1000, d = static_cast<double>(R(0.3));
    for (std::uint64_t i = 0; i < 2000; ++i) {
        Vec3<S> x, y;
        needle(sigma, 1e-3, 6.2831853 * Random{2, 0}.uniform(i), x, y);
        const detail::PrecisionFactor<S> f = detail::precision_factor(x, y, S(R(d)));
        const Sym2<S> cov = detail::gram(x, y, S(R(d)));
        const S det = cov.determinant();
        const Sym2<S> conic{cov.yy / det, -cov.xy / det, cov.xx / det};
        // Offsets within three standard deviations, along the needle and across.
        const double away = 3 * std::sqrt(Random{2, 1}.uniform(i));
        const double turn = 6.2831853 * Random{2, 2}.uniform(i);
        const double along = sigma * away * std::cos(turn);
        const double across = std::sqrt(d) * away * std::sin(turn);
        const double ux = first(x[0]) / sigma, uy = first(y[0]) / sigma;
        const R dx = static_cast<R>(along * ux - across * uy);
        const R dy = static_cast<R>(along * uy + across * ux);
        const double power = -0.5 * first(f.quadratic(S(dx), S(dy)));
        const double conic_power = -0.5 * first(conic.quadratic(Vec2<S>(S(dx), S(dy))));
        long double form = 0; // d^T P d by the cofactors, exactly
        {
            long double xx = d, yy = d, xy = 0;
            for (int k = 0; k < 3; ++k) {
                const long double p = first(x[k]), q = first(y[k]);
                xx += p * p, yy += q * q, xy += p * q;
            }
            const long double l = static_cast<long double>(dy) - xy / xx * dx;
            form =
                static_cast<long double>(dx) * dx / xx + l * l * (xx / exact_determinant(x, y, d));
        }
        const double truth = static_cast<double>(-form / 2);
        negative = negative && power <= 0;
        worsen(worst, std::abs(power - truth));
        worsen(conic_worst, std::abs(conic_power - truth));
        worsen(alpha, std::abs(std::exp(power) - std::exp(truth)));
        worsen(conic_alpha, std::abs(std::exp(std::min(0.0, conic_power)) - std::exp(truth)));
    }
    // An exponent of 4.5 at three standard deviations adds its own rounding.
    const double scale = unit<S> * sigma / std::sqrt(d) * 4;
    report.at_most("A2", kind_of<S>(), "1000 px, 2000 offsets within 3 sigma; exponent", 2 * scale,
                   worst);
    const double alpha_demanded = sizeof(R) == 4 ? 1e-4 : 1e-12;
    report.at_most("A2", kind_of<S>(), "the same; alpha", alpha_demanded, alpha);
    report.holds("A2", kind_of<S>(), "the same; no exponent is positive", negative);
    report.textbook("A2", kind_of<S>(), "conic A dx^2 + 2 B dx dy + C dy^2", 2 * scale,
                    conic_worst);
    report.textbook("A2", kind_of<S>(), "conic; alpha", alpha_demanded, conic_alpha);
}

template <class S>
bool definite(const Sym3<S>& g) {
    const long double xx = first(g.xx), xy = first(g.xy), xz = first(g.xz), yy = first(g.yy),
                      yz = first(g.yz), zz = first(g.zz);
    const long double det =
        xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz);
    return det > 0 && xx * yy - xy * xy > 0;
}

/// Smallest axis recovered from the factor, and whether the covariance is definite.
template <class S>
void a3(Report& report) {
    using R = real_t<S>;
    double worst = 0;
    Index indefinite = 0, total = 0;
    for (const double thin : {1e-1, 1e-2, 1e-3, 1e-4, 1e-5})
        for (std::uint64_t i = 0; i < 2000; ++i, ++total) {
            Quat<S> q;
            for (int k = 0; k < 4; ++k)
                q[k] =
                    S(static_cast<R>(Random{3, 0}.normal(8 * i + static_cast<std::uint64_t>(k))));
            const S s(static_cast<R>(thin));
            Mat3<S> m = quat_matrix(quat_normalized(q));
            for (int r = 0; r < 3; ++r)
                for (int c = 1; c < 3; ++c) m(r, c) = m(r, c) * s;
            const Vec3<S> column = m.col(2);
            worsen(worst, std::abs(first(norm(column)) / first(s) - 1));
            const Sym3<S> g = detail::gram(m);
            if (!definite(g)) ++indefinite;
        }
    // From the rows of a unit quaternion, whose columns are of length 1 within a few units.
    report.at_most("A3", kind_of<S>(), "scales (1, s, s), s to 1e-5: smallest axis of M = R S",
                   sizeof(R) == 4 ? 1e-6 : 1e-14, worst);
    if (sizeof(R) == 4)
        report.textbook("A3", kind_of<S>(), "Sigma = M M^T: share that is indefinite", 0.01,
                        double(indefinite) / double(total));
}

/// A shape of the head's size in front of a plain camera.
template <class S>
Projector<S> plain_lens(double dilation = 0.3) {
    using R = real_t<S>;
    Pinhole<R> c;
    c.fx = c.fy = R(1000);
    c.cx = c.cy = R(256);
    c.width = c.height = 512;
    return Projector<S>(Projector<R>(c, 0.3, dilation));
}
template <class S>
Shape<S> shape_of(const std::array<double, 10>& a) {
    using R = real_t<S>;
    const auto at = [&](std::size_t i) { return S(static_cast<R>(a[i])); };
    return {Vec3<S>(at(0), at(1), at(2)), Quat<S>(at(3), at(4), at(5), at(6)),
            Vec3<S>(at(7), at(8), at(9))};
}

/// <cotangent, J v> by duals in long double and <J^T cotangent, v> by the vjp: their gap.
template <class T>
double projection_gap(const std::array<double, 10>& x, std::uint64_t seed, const Projector<T>& lens,
                      double dilation) {
    using D = Dual<long double, 1>;
    Shape<D> shape;
    std::array<double, 10> v;
    for (std::size_t i = 0; i < 10; ++i) v[i] = Random{seed, 7}.normal(i);
    const auto lift = [&](std::size_t i) {
        D d(static_cast<long double>(static_cast<T>(x[i])));
        d.d[0] = static_cast<T>(v[i]);
        return d;
    };
    shape = {Vec3<D>(lift(0), lift(1), lift(2)), Quat<D>(lift(3), lift(4), lift(5), lift(6)),
             Vec3<D>(lift(7), lift(8), lift(9))};
    Pinhole<long double> c;
    c.fx = c.fy = 1000, c.cx = c.cy = 256, c.width = c.height = 512;
    const Projector<D> wide(Projector<long double>(c, 0.3, dilation));
    const ScreenGaussian<D> s = project(shape, wide);
    // At one pixel one standard deviation off: e = -|w|^2 / 2, with its own cotangent g = 1.
    const D dx = D(0.7L) / s.precision.k1;
    const D px = s.centre[0] + dx, py = s.centre[1] + s.precision.m * dx;
    const D fixed_x(px.value), fixed_y(py.value);
    const D e = D(-0.5L) * s.precision.quadratic(fixed_x - s.centre[0], fixed_y - s.centre[1]) +
                D(0.1L) * s.depth;
    const auto plain = project(shape_of<T>(x), lens);
    const T u = T(0.7), w = T(0);
    ScreenCotangent<T> g;
    g.centre = Vec2<T>(plain.precision.k1 * u, T(0));
    g.moment = {u * u, u * w, w * w};
    g.depth = T(0.1);
    const Shape<T> back = project_vjp(shape_of<T>(x), lens, g);
    long double reverse = 0, scale = 0;
    const auto add = [&](std::size_t i, T gi) {
        const long double term = static_cast<long double>(gi) * static_cast<T>(v[i]);
        reverse += term, scale += std::abs(term);
    };
    for (std::size_t i = 0; i < 3; ++i) add(i, back.mean[static_cast<int>(i)]);
    for (std::size_t i = 0; i < 4; ++i) add(3 + i, back.rotation[static_cast<int>(i)]);
    for (std::size_t i = 0; i < 3; ++i) add(7 + i, back.scale[static_cast<int>(i)]);
    return static_cast<double>(std::abs(reverse - e.d[0]) / scale);
}

/// Error of the second row of L M along the needle against long double of the same rows A and B,
/// relative to what it is of a needle of the same scales across which B stands; worsens `cancelled`
/// by that of k2 (y - m x). The rows' own rounding is no matter of this formula: where A nearly
/// vanishes along the needle, it alone is 1e-4 of the result in float.
template <class T>
double needle_gap(const std::array<double, 10>& a, double& cancelled) {
    const Shape<T> s = shape_of<T>(a);
    Shape<long double> wide;
    const Projector<T> lens = plain_lens<T>();
    const Projector<long double> wide_lens(lens);
    const detail::Linearised<T, NoDistortion> l(s, lens);
    detail::Linearised<long double, NoDistortion> w(shape_of<long double>(a), wide_lens);
    for (int i = 0; i < 3; ++i) {
        wide.scale[i] = s.scale[i];
        w.along_x[i] = l.along_x[i];
        w.along_y[i] = l.along_y[i];
    }
    const auto factor = [](const auto& of, const auto& scale, const auto& d) {
        return detail::precision_factor(detail::scaled_by(of.along_x, scale),
                                        detail::scaled_by(of.along_y, scale), d);
    };
    const auto f = factor(l, s.scale, lens.dilation);
    const auto truth = detail::whitened_second_row(w, wide.scale,
                                                   factor(w, wide.scale, wide_lens.dilation),
                                                   wide_lens.dilation);
    const Vec3<T> row = detail::whitened_second_row(l, s.scale, f, lens.dilation);
    // Along the needle alone: that is what turns it.
    const Vec3<long double> x = detail::scaled_by(w.along_x, wide.scale);
    const long double d = wide_lens.dilation;
    const long double size = factor(w, wide.scale, d).k2 * wide.scale[0] * d *
                             std::sqrt(dot(w.along_y, w.along_y)) / (dot(x, x) + d);
    const auto relative = [&](T v) {
        return static_cast<double>(std::abs(static_cast<long double>(v) - truth[0]) / size);
    };
    worsen(cancelled, relative(f.k2 * (l.along_y[0] * s.scale[0] - f.m * l.along_x[0] * s.scale[0])));
    return relative(row[0]);
}

template <class T>
void a4_a18(Report& report) {
    const double tol = sizeof(T) == 4 ? 1e-6 : 1e-14;
    // A4: isotropic, 1e5 px, and one with no extent but the dilation.
    double worst = 0;
    for (const double size : {100.0, 1e-9})
        for (std::uint64_t i = 0; i < 20; ++i)
            worsen(worst, projection_gap<T>({0.01, 0.02, 1, 1, 0.2, 0.1, 0.3, size, size, size}, i,
                                            plain_lens<T>(), 0.3));
    report.at_most("A4", kind_of<T>(), "isotropic of 1e5 px and of none but the dilation: vjp", tol,
                   worst);
    // The backward of the first implementation scales by 1 / (det^2 + 1e-7).
    const T det = T(0.09);
    report.textbook("A4", kind_of<T>(), "1 / (det^2 + 1e-7) at det = 0.09", tol,
                    std::abs(double(T(1) / (det * det + T(1e-7)) * det * det) - 1));
    const T big = T(3e19);
    if (sizeof(T) == 4)
        report.textbook_fails("A4", kind_of<T>(), "1 / (det^2 + 1e-7) at det = 3e19 is not 0",
                              T(1) / (big * big + T(1e-7)) > T(0));
    // A19: along a needle y - m x cancels, and with it the gradient of its turn.
    worst = 0;
    double cancelled = 0;
    for (std::uint64_t i = 0; i < 200; ++i) {
        const Random turn{5, i};
        const std::array<double, 10> needle{0.01, -0.02, 1,   turn.normal(0), turn.normal(1),
                                            turn.normal(2), turn.normal(3), 1e6, 1e-6, 1e-6};
        worsen(worst, needle_gap<T>(needle, cancelled));
    }
    report.at_most("A19", kind_of<T>(), "scales (1e6, 1e-6, 1e-6), 200 turns: turn of the rows L M",
                   sizeof(T) == 4 ? 1e-6 : 1e-14, worst);
    report.textbook("A19", kind_of<T>(), "k2 (y - m x)", sizeof(T) == 4 ? 1e-6 : 1e-14, cancelled);
    // A18: anisotropic and rotated, where a dropped half shows.
    worst = 0;
    const double a = 37 * 3.14159265358979 / 360, n = std::sin(a) / std::sqrt(14.0);
    for (std::uint64_t i = 0; i < 200; ++i)
        worsen(worst, projection_gap<T>({0.1, -0.2, 2, std::cos(a), n, 2 * n, 3 * n, 1, 0.3, 0.1},
                                        i, plain_lens<T>(), 0.3));
    report.at_most("A18", kind_of<T>(), "scales (1, .3, .1), 37 deg about (1, 2, 3): dot product",
                   sizeof(T) == 4 ? 2e-6 : 1e-14, worst);
    // <g, d> of symmetric matrices with the off-diagonal pair halved or doubled.
    const Sym2<T> g{T(0.3), T(-0.7), T(0.2)}, d{T(0.5), T(0.4), T(-0.1)};
    const double full = double(g.xx * d.xx + g.xy * d.xy + g.yy * d.yy);
    report.at_most("A18", kind_of<T>(), "the pairing counts the stored number once", 0,
                   std::abs(double(pairing(g, d)) - full));
    report.textbook("A18", kind_of<T>(), "half of g_xy in the backward", 1e-14,
                    std::abs(double(g.xx * d.xx + g.xy * d.xy / 2 + g.yy * d.yy) - full));
}

template <class S>
void a5_a12_a13(Report& report) {
    using R = real_t<S>;
    const double inf = std::numeric_limits<double>::infinity();
    const auto with_scale = [&](double sx, double sy, double sz, double dilation) {
        return project(shape_of<S>({0, 0, 1, 1, 0.3, 0.2, 0.1, sx, sy, sz}),
                       plain_lens<S>(dilation));
    };
    // A5: a determinant of 0, of NaN, of infinity is not drawable.
    bool refused = !truth(with_scale(0, 0, 0, 0).drawable);
    const double tiny = sizeof(R) == 4 ? 1e-24 : 1e-160;
    refused = refused && !truth(with_scale(tiny, tiny, tiny, 0).drawable);
    refused = refused && !truth(with_scale(std::nan(""), 1, 1, 0.3).drawable);
    if (sizeof(R) == 4) refused = refused && !truth(with_scale(1e30, 1e30, 1e30, 0.3).drawable);
    refused = refused && !truth(with_scale(inf, 1, 1, 0.3).drawable);
    report.holds("A5", kind_of<S>(), "det in {0, denormal, NaN, inf}: not drawable", refused);
    const R dets[] = {R(-1e-8), std::numeric_limits<R>::denorm_min(), R(NAN)};
    bool textbook = true; // "det == 0" refuses them all
    for (const R det : dets) textbook = textbook && det == R(0);
    report.textbook_fails("A5", kind_of<S>(), "det == 0 as the only test", textbook);

    // A12: a surfel, and an axis that is denormal.
    bool surfel = true;
    for (const double thin : {0.0, 1e-45, 1e-20})
        for (int axis = 0; axis < 3; ++axis) {
            double s[3] = {0.05, 0.05, 0.05};
            s[axis] = thin;
            const auto g = with_scale(s[0], s[1], s[2], 0.3);
            surfel = surfel && truth(g.drawable) && first(g.determinant) > 0 &&
                     std::isfinite(first(g.precision.k2));
        }
    report.holds("A12", kind_of<S>(), "each axis 0, denormal, 1e-20: drawn, finite", surfel);
    const R zero = R(0), mine = R(1) / zero * zero;
    report.textbook_fails("A12", kind_of<S>(), "precision from 1 / s, times an offset of 0",
                          std::isfinite(mine));

    // A13: log-scales at the thresholds are drawable or culled, never NaN.
    bool declared = true;
    for (const double s : {-110.0, -51.99, -43.67, -20.0, 0.0, 10.0, 11.09, 22.18, 44.36, 88.72}) {
        const R scale = std::exp(static_cast<R>(s));
        const auto g = with_scale(double(scale), double(scale), double(scale), 0.3);
        const bool drawn = truth(g.drawable);
        declared = declared &&
                   (!drawn || (std::isfinite(first(g.determinant)) &&
                               std::isfinite(first(g.precision.k1)) && first(g.precision.k2) > 0));
        if (s >= -20 && s <= 10) declared = declared && drawn;
        if (s > 40 && sizeof(R) == 4) declared = declared && !drawn;
    }
    report.holds("A13", kind_of<S>(), "log-scale -110 to 88.72: drawn in -20..10, never NaN",
                 declared);
    const R s22 = std::exp(static_cast<R>(sizeof(R) == 4 ? 22.2 : 178.0)), v = s22 * s22;
    report.textbook_fails("A13", kind_of<S>(), "det^2 in the backward beyond log-scale 11",
                          std::isfinite(v * v * v * v));
}

} // namespace

void determinants(Report& report) {
    every_scalar([&]<class S>() {
        a1<S>(report);
        a2<S>(report);
        a3<S>(report);
        a5_a12_a13<S>(report);
    });
    a4_a18<float>(report);
    a4_a18<double>(report);
}

} // namespace rye::hard
