// SPDX-License-Identifier: Apache-2.0
// View-dependent colour (E1-E4).
#include <limits>

#include <rye/autodiff/dual.hpp>
#include <rye/gaussian/sh_color.hpp>
#include <rye/math/rotation.hpp>

#include "report.hpp"

namespace rye::hard {
namespace {

constexpr int degree = 3, more = 15;

template <class S>
struct Bands {
    S constant[3], rest[3 * more];
    explicit Bands(std::uint64_t seed) {
        for (int i = 0; i < 3; ++i)
            constant[i] = S(static_cast<real_t<S>>(Random{seed, 0}.normal(std::uint64_t(i))));
        for (int i = 0; i < 3 * more; ++i)
            rest[i] = S(static_cast<real_t<S>>(0.2 * Random{seed, 1}.normal(2 * std::uint64_t(i))));
    }
};

template <class S>
void e1_e2(Report& report) {
    using R = real_t<S>;
    const Bands<S> bands(1);
    bool constant = true, finite = true;
    double worst = 0;
    const S zero = S(R(0));
    const Vec3<S> g(S(R(0.3)), S(R(-0.2)), S(R(0.5)));
    for (const double d : {0.0, 1e-45, 1e-38, 1e-20, 3e-8, 1.0}) {
        const Vec3<S> mean(S(static_cast<R>(d)), S(static_cast<R>(d * 0.5)), zero);
        const Vec3<S> eye(zero, zero, zero);
        const ShColor<S, degree> c(mean, eye, bands.constant, bands.rest);
        S gc[3], gr[3 * more];
        const Vec3<S> back = c.vjp(g, bands.rest, gc, gr);
        for (int k = 0; k < 3; ++k) finite = finite && std::isfinite(first(c.raw[k]));
        if (d == 0)
            for (int k = 0; k < 3; ++k) {
                const double dc = 0.5 + 0.28209479177387814 * first(bands.constant[k]);
                constant = constant && std::abs(first(c.raw[k]) - dc) < 1e-6 && first(back[k]) == 0;
            }
        // E2: (g - y (y . g)) / |d| of the direction, against long double, on its own scale.
        const Vec3<S> x(mean[0], mean[1], mean[2]);
        const double n = std::hypot(first(mean[0]), first(mean[1]));
        if (d >= 1e-20) {
            const Vec3<S> got = normalized_vjp(x, g);
            const long double p = first(mean[0]) / static_cast<long double>(n),
                              q = first(mean[1]) / static_cast<long double>(n);
            const long double along = p * first(g[0]) + q * first(g[1]);
            const long double truth[3] = {(first(g[0]) - p * along) / n,
                                          (first(g[1]) - q * along) / n, first(g[2]) / n};
            for (int k = 0; k < 3; ++k)
                worsen(worst, static_cast<double>(std::abs(first(got[k]) - truth[k]) * n) /
                                  (unit<S> * 0.62));
        }
    }
    report.holds("E1", kind_of<S>(), "mean at the eye: constant band, gradient 0 by direction",
                 constant);
    report.holds("E1", kind_of<S>(), "|d| in {0, 1e-45, 1e-38, 1e-20, 3e-8}: finite", finite);
    const R none = R(0);
    report.textbook_fails("E1", kind_of<S>(), "d / |d| at d = 0",
                          std::isfinite(none / std::sqrt(none)));
    report.at_most("E2", kind_of<S>(), "|d| 1e-20, 3e-8, 1: gradient of d / |d| [u |g| / |d|]", 4,
                   worst);
    const R d = sizeof(R) == 4 ? R(1e-20) : R(1e-120), sum2 = d * d;
    report.textbook_fails("E2", kind_of<S>(), "1 / sqrt(sum2^3) for |d| = 1e-20",
                          std::isfinite(R(1) / std::sqrt(sum2 * sum2 * sum2)));
}

/// Rotation of the basis: sums of squares of a band do not change, nor does any product of two
/// bands' values at equally rotated pairs of directions.
template <class S>
void e3(Report& report) {
    using R = real_t<S>;
    double worst = 0, pole = 0;
    for (std::uint64_t i = 0; i < 500; ++i) {
        Vec3<S> a, b;
        Quat<S> q;
        for (int k = 0; k < 3; ++k) {
            a[k] = S(static_cast<R>(Random{3, 0}.normal(8 * i + std::uint64_t(k))));
            b[k] = S(static_cast<R>(Random{3, 2}.normal(8 * i + std::uint64_t(k))));
        }
        for (int k = 0; k < 4; ++k)
            q[k] = S(static_cast<R>(Random{3, 4}.normal(8 * i + std::uint64_t(k))));
        if (i % 5 == 0) a = Vec3<S>(S(R(0)), S(R(0)), S(R(1))); // at the pole
        a = normalized(a), b = normalized(b), q = quat_normalized(q);
        const auto p = sh_basis<S, 4>(a), r = sh_basis<S, 4>(b);
        const auto pt = sh_basis<S, 4>(quat_rotate(q, a)), rt = sh_basis<S, 4>(quat_rotate(q, b));
        int at = 0;
        for (int l = 0; l <= 4; ++l) {
            double before = 0, after = 0;
            for (int m = 0; m < 2 * l + 1; ++m, ++at) {
                const auto j = static_cast<std::size_t>(at);
                before += first(p[j]) * first(r[j]);
                after += first(pt[j]) * first(rt[j]);
            }
            worsen(worst, std::abs(before - after));
        }
        // Angles at the pole: phi = atan2(0, 0) has a derivative 1 / sin(theta).
        if (i % 5 == 0) worsen(pole, 1 / std::sin(std::acos(first(a[2]))));
    }
    report.at_most("E3", kind_of<S>(), "band products turned together, degree 4, poles too",
                   sizeof(R) == 4 ? 1e-5 : 1e-14, worst);
    report.textbook("E3", kind_of<S>(), "1 / sin(theta) of polar angles, at the pole", 1e6, pole);
}

template <class T>
void e4(Report& report) {
    using D = Dual<T, 1>;
    bool same = true, ungated = true;
    const T u = std::numeric_limits<T>::epsilon();
    for (const T c : {T(-0.5) * (T(1) + u), T(-0.5) * (T(1) - u), T(-0.5), T(0.3)}) {
        const T band = c / static_cast<T>(detail::sh_factor(0));
        D lifted(band);
        lifted.d[0] = T(1);
        const D constants[3] = {lifted, lifted, lifted};
        const Vec3<D> zero(D(T(0)), D(T(0)), D(T(0))), ahead(D(T(0)), D(T(0)), D(T(1)));
        const ShColor<D, 0> dual(ahead, zero, constants, nullptr);
        const T plain[3] = {band, band, band};
        const ShColor<T, 0> color(Vec3<T>(T(0), T(0), T(1)), Vec3<T>(T(0), T(0), T(0)), plain,
                                  nullptr);
        T g[3];
        color.vjp(Vec3<T>(T(1), T(1), T(1)), nullptr, g, nullptr);
        same = same && g[0] == dual.rgb()[0].d[0] && (color.rgb()[0] > T(0)) == (g[0] != T(0));
        if (c < T(-0.5)) ungated = dual.rgb()[0].d[0] == static_cast<T>(detail::sh_factor(0));
    }
    report.holds("E4", kind_of<T>(), "c in -.5 (1 +- u), -.5: gate equal in value, vjp, dual",
                 same);
    report.textbook_fails("E4", kind_of<T>(), "the gradient without the gate", ungated);
}

} // namespace

void colours(Report& report) {
    every_scalar([&]<class S>() {
        e1_e2<S>(report);
        e3<S>(report);
    });
    e4<float>(report);
    e4<double>(report);
}

} // namespace rye::hard
