// SPDX-License-Identifier: Apache-2.0
// Quaternions, arcs, exponentials and logarithms of rotations (C1-C5, C9-C12, C14).
#include <limits>

#include <rye/autodiff/dual.hpp>
#include <rye/math/rotation.hpp>

#include "report.hpp"

namespace rye::hard {
namespace {

template <class S, int N>
Vec<S, N> draw(std::uint64_t seed, std::uint64_t i) {
    Vec<S, N> v;
    for (int k = 0; k < N; ++k)
        v[k] = S(static_cast<real_t<S>>(Random{seed, 0}.normal(8 * i + std::uint64_t(k))));
    return v;
}
template <class S, int N>
Vec<long double, N> wide(const Vec<S, N>& v) {
    Vec<long double, N> r;
    for (int k = 0; k < N; ++k) r[k] = static_cast<long double>(first(v[k]));
    return r;
}
template <class S, int N>
double gap(const Vec<S, N>& a, const Vec<long double, N>& b) {
    return static_cast<double>((wide(a) - b).cwiseAbs().maxCoeff());
}
template <class S>
double orthogonality(const Mat3<S>& r) {
    Mat<double, 3, 3> m;
    for (int k = 0; k < 9; ++k) m.data()[k] = first(r.data()[k]);
    return (m.transpose() * m - Mat<double, 3, 3>::Identity()).cwiseAbs().maxCoeff();
}

template <class S>
void c1_c3(Report& report) {
    using R = real_t<S>;
    const double u = unit<S>;
    double worst = 0, naive = 0, along = 0;
    for (const double magnitude : {1e-38, 1e-30, 1e-23, 1e-20, 1e-10, 1.0, 1e10, 1e19, 1e30, 1e37})
        for (std::uint64_t i = 0; i < 200; ++i) {
            // Where denormals are zero, entries or gradients of these would be.
            if (flushed() && (magnitude < 1e-29 || magnitude > 1e30)) continue;
            Quat<S> q = draw<S, 4>(1, i);
            for (int k = 0; k < 4; ++k) q[k] = q[k] * S(static_cast<R>(magnitude));
            const Quat<long double> truth = wide(q) / wide(q).norm();
            worsen(worst, gap(quat_normalized(q), truth) / (2 * u));
            const S n2 = dot(q, q);
            using std::sqrt;
            const S n = sqrt(n2);
            worsen(naive, gap(Quat<S>(q[0] / n, q[1] / n, q[2] / n, q[3] / n), truth) / (2 * u));
            // Below 1e-37 the gradient itself overflows float.
            const Quat<S> w = draw<S, 4>(2, i);
            const Quat<long double> g = wide(quat_normalized_vjp(q, w));
            const long double scale = wide(w).norm() / wide(q).norm();
            if (magnitude > 1e-37)
                worsen(along, static_cast<double>(std::abs(truth.dot(g)) / scale) / u);
        }
    // Subnormal entries have fewer digits already on input.
    const bool is_float = sizeof(R) == 4;
    report.at_most("C1", kind_of<S>(), "|q| from 1e-38 to 1e37: error [ulp of 1]", 3, worst);
    if (is_float)
        report.textbook("C1", kind_of<S>(), "q / sqrt(q . q): error [ulp of 1]", 3, naive);
    const Quat<S> zero(S(R(0)), S(R(0)), S(R(0)), S(R(0))), unit_q = quat_normalized(zero);
    report.holds("C1", kind_of<S>(), "q = 0 is the identity, with gradient 0",
                 first(unit_q[0]) == 1 && first(unit_q[1]) == 0 &&
                     first(quat_normalized_vjp(zero, draw<S, 4>(2, 1))[2]) == 0);
    report.at_most("C3", kind_of<S>(), "q . gradient, |q| 1e-30 to 1e37 [u |w| / |q|]", 4, along);
}

template <class T>
void c2_c3(Report& report) {
    using D = Dual<T, 1>;
    double worst = 0, dropped = 0, unit_error = 0, raw = 0;
    for (const double magnitude : {1e-6, 1e-3, 1.0, 1e3})
        for (std::uint64_t i = 0; i < 500; ++i) {
            const Quat<T> q = draw<T, 4>(3, i) * T(magnitude), v = draw<T, 4>(4, i) * T(magnitude);
            Quat<D> d;
            for (int k = 0; k < 4; ++k) d[k] = D(q[k]), d[k].d[0] = v[k];
            const Quat<D> y = quat_normalized(d);
            const Quat<T> w = draw<T, 4>(5, i), g = quat_normalized_vjp(q, w);
            double forward = 0, reverse = 0, plain = 0;
            const double scale = double(norm(w)) * double(norm(v)) / double(norm(q));
            for (int k = 0; k < 4; ++k) {
                forward += double(y[k].d[0]) * double(w[k]);
                reverse += double(g[k]) * double(v[k]);
                plain += double(w[k]) * double(v[k]) / double(norm(q));
            }
            worsen(worst, std::abs(forward - reverse) / scale);
            worsen(dropped, std::abs(forward - plain) / scale);
        }
    const double demanded = sizeof(T) == 4 ? 2e-6 : 1e-14;
    report.at_most("C3", kind_of<T>(), "|q| 1e-6 to 1e3: <Jv, w> = <v, J'w>", demanded, worst);
    report.textbook("C3", kind_of<T>(), "gradient without the projection I - q q'", demanded,
                    dropped);
    for (const double n : {0.5, 0.99, 1.01, 2.0})
        for (std::uint64_t i = 0; i < 50; ++i) {
            const Quat<T> q = quat_normalized(draw<T, 4>(6, i)) * T(n);
            worsen(unit_error, std::abs(double(norm(quat_normalized(q))) - 1) / unit<T>);
            worsen(raw, orthogonality(quat_matrix(q)) / unit<T>);
        }
    report.at_most("C2", kind_of<T>(), "|q| in {.5, .99, 1.01, 2} normalised: | |q| - 1 | [u]", 4,
                   unit_error);
    report.textbook("C2", kind_of<T>(), "the matrix of a quaternion that is not unit: R'R - I [u]",
                    16, raw);
}

template <class S>
void c5(Report& report) {
    using R = real_t<S>;
    double worst = 0, naive = 0, ortho = 0;
    bool same = true;
    for (const double delta : {3.1, 1.0, 0.1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 0.0})
        for (std::uint64_t i = 0; i < 1000; ++i) {
            const Vec3<S> a = normalized(draw<S, 3>(7, i));
            const Vec3<S> n = normalized(cross(a, draw<S, 3>(8, i)));
            const double t = 3.14159265358979324 - delta;
            const S c(static_cast<R>(std::cos(t))), s(static_cast<R>(std::sin(t)));
            Vec3<S> b;
            for (int k = 0; k < 3; ++k) b[k] = c * a[k] + s * n[k];
            b = delta == 0 ? Vec3<S>(-a[0], -a[1], -a[2]) : normalized(b);
            const Quat<S> q = shortest_arc(a, b);
            const auto miss = [&](const Quat<S>& r) { return gap(quat_rotate(r, a), wide(b)); };
            worsen(worst, miss(q));
            worsen(ortho, orthogonality(quat_matrix(q)));
            const Vec3<S> x = cross(a, b);
            using std::sqrt;
            Quat<S> h(S(R(1)) + dot(a, b), x[0], x[1], x[2]);
            const S size = sqrt(dot(h, h));
            for (int k = 0; k < 4; ++k) h[k] = h[k] / size;
            worsen(naive, miss(h));
            if (delta == 0) same = same && gap(shortest_arc(a, b), wide(q)) == 0;
        }
    const double demanded = sizeof(R) == 4 ? 1e-6 : 2e-15;
    report.at_most("C5", kind_of<S>(), "pi - angle {3.1 .. 1e-7, 0}, 1000 axes: |R a - b|",
                   demanded, worst);
    report.at_most("C5", kind_of<S>(), "the same: R'R - I of the quaternion's matrix", 20 * unit<S>,
                   ortho);
    report.holds("C5", kind_of<S>(), "the antipode has one axis", same);
    report.textbook("C5", kind_of<S>(), "(1 + a . b, a x b) normalised", demanded, naive);
}

template <class T>
void c4_c12(Report& report) {
    const Quat<T> q = quat_normalized(draw<T, 4>(9, 1));
    bool finite = true;
    for (const double f : {1.0, 1 - 1e-7, 1 + 1e-7}) {
        const Quat<T> sum = q - q * T(f), n = quat_normalized(sum);
        const Quat<T> g = quat_normalized_vjp(sum, draw<T, 4>(9, 2));
        finite = finite && std::abs(double(norm(n)) - 1) < 1e-5 && g.allFinite();
    }
    report.holds("C4", kind_of<T>(),
                 "q - q (1 +- {0, 1e-7}): unit or the identity, finite gradient", finite);
    const Quat<T> none = q - q;
    report.textbook_fails("C4", kind_of<T>(), "q / sqrt(q . q) of the sum 0",
                          std::isfinite(none[0] / std::sqrt(dot(none, none))));
    // C12: rotations are composed as quaternions, w = 0 too.
    double worst = 0;
    for (std::uint64_t i = 0; i < 10000; ++i) {
        Quat<T> a = quat_normalized(draw<T, 4>(10, i)), b = quat_normalized(draw<T, 4>(11, i));
        if (i % 10 == 0) a[0] = T(0), a = quat_normalized(a);
        worsen(worst, gap(quat_product(a, b), quat_product(wide(a), wide(b))) / unit<T>);
    }
    report.at_most("C12", kind_of<T>(), "10000 products, w = 0 among them: error [u]", 3, worst);
    using D = Dual<T, 1>;
    // The quaternion of a half turn by square roots of sums of the diagonal.
    D trace(T(0));
    trace.d[0] = T(1);
    using std::sqrt;
    report.textbook_fails("C12", kind_of<T>(), "w = sqrt(1 + trace) / 2 at a half turn: derivative",
                          std::isfinite((T(0.5) * sqrt(trace)).d[0]));
    Mat3<D> half;
    for (int r = 0; r < 3; ++r)
        for (int c = 0; c < 3; ++c) half(r, c) = D(T(r == c ? (r == 0 ? 1 : -1) : 0));
    half(2, 1).d[0] = T(1), half(1, 2).d[0] = T(-1);
    const Quat<D> out = matrix_quat(half);
    report.holds("C12", kind_of<T>(), "matrix to quaternion at a half turn: finite derivative",
                 isfinite(out[0]) && isfinite(out[1]) && isfinite(out[2]) && isfinite(out[3]));
}

template <class S>
void c9(Report& report) {
    using R = real_t<S>;
    double length = 0, ends = 0, linear = 0, naive = 0;
    for (const double theta : {0.0, 1e-7, 1e-4, 1.0, 3.14159165358979, 3.14159265358979})
        for (std::uint64_t i = 0; i < 100; ++i) {
            const Quat<S> a = quat_normalized(draw<S, 4>(12, i));
            const Vec3<S> n = normalized(draw<S, 3>(13, i));
            const S c(static_cast<R>(std::cos(theta / 2))), s(static_cast<R>(std::sin(theta / 2)));
            const Quat<S> b = quat_product(a, Quat<S>(c, s * n[0], s * n[1], s * n[2]));
            for (const double t : {0.0, 0.25, 0.5, 1.0, -1.0, 2.0}) {
                const Quat<S> q = quat_slerp(a, b, S(static_cast<R>(t)));
                length = std::max(length, std::abs(double(wide(q).norm()) - 1) / unit<S>);
                if (t == 0) worsen(ends, gap(q, wide(a)));
                if (t == 1) worsen(ends, std::min(gap(q, wide(b)), gap(Quat<S>(-q), wide(b))));
                // Angle of a* q; beyond half a turn slerp goes the shorter way, so up to 3 rad.
                if (theta > 3) continue;
                const Quat<long double> turn = quat_product(quat_conjugate(wide(a)), wide(q));
                const double angle =
                    2 * std::atan2(std::hypot(double(turn[1]), double(turn[2]), double(turn[3])),
                                   std::abs(double(turn[0])));
                worsen(linear, std::abs(angle - std::abs(t) * theta));
            }
            const double sine = std::sin(static_cast<R>(theta / 2));
            if (theta == 0) worsen(naive, std::sin(0.5 * theta / 2) / sine);
        }
    const bool f = sizeof(R) == 4;
    report.at_most("C9", kind_of<S>(), "theta 0 to pi, t -1 to 2: | |q| - 1 | [u]", 4, length);
    report.at_most("C9", kind_of<S>(), "ends are met", f ? 3e-7 : 1e-15, ends);
    report.at_most("C9", kind_of<S>(), "angle is linear in t", f ? 1e-6 : 2e-15, linear);
    report.textbook("C9", kind_of<S>(), "sin(t theta) / sin(theta) at theta = 0", f ? 3e-7 : 1e-15,
                    naive);
}

template <class S>
void c10_c11(Report& report) {
    using R = real_t<S>;
    double worst = 0, naive = 0, back = 0, trace_error = 0;
    for (const double theta : {0.0, 1e-38, 1e-6, 1e-4, 1e-3, 0.49, 0.51, 1.0, 3.0, 3.1415})
        for (std::uint64_t i = 0; i < 200; ++i) {
            Vec3<S> w = normalized(draw<S, 3>(14, i));
            for (int k = 0; k < 3; ++k) w[k] = w[k] * S(static_cast<R>(theta));
            const Mat3<S> m = so3_exp(w);
            const Mat3<long double> truth = so3_exp(wide(w));
            for (int k = 0; k < 9; ++k)
                worsen(worst, std::abs(first(m.data()[k]) - double(truth.data()[k])));
            const Vec3<S> log = so3_log(m);
            worsen(back, gap(log, wide(w)));
            if (theta > 0 && theta < 0.01) {
                const R t = static_cast<R>(theta);
                worsen(naive, std::abs(double((R(1) - std::cos(t)) / (t * t)) - 0.5));
            }
            const double arg = (first(m(0, 0)) + first(m(1, 1)) + first(m(2, 2)) - 1) / 2;
            const R angle = std::acos(static_cast<R>(std::clamp(arg, -1.0, 1.0)));
            if (theta > 3) worsen(trace_error, std::abs(double(angle) - theta));
            if (theta > 1e-5 && theta < 0.01)
                worsen(trace_error, std::abs(double(angle) / theta - 1));
        }
    const bool f = sizeof(R) == 4;
    report.at_most("C10", kind_of<S>(), "theta 0, 1e-38 to pi: entries of exp", 12 * unit<S>,
                   worst);
    report.textbook("C10", kind_of<S>(), "(1 - cos t) / t^2", 12 * unit<S>, naive);
    report.at_most("C11", kind_of<S>(), "log(exp(w)) - w", f ? 1e-6 : 2e-15, back);
    report.textbook("C11", kind_of<S>(), "angle by acos((trace - 1) / 2)", f ? 1e-6 : 2e-15,
                    trace_error);
    // Exactly half a turn about each axis, and 1e-8 from it about random ones.
    double at_pi = 0;
    for (int k = 0; k < 3; ++k) {
        Mat3<S> r;
        for (int i = 0; i < 9; ++i) r.data()[i] = S(R(i % 4 == 0 ? (i / 4 == k ? 1 : -1) : 0));
        const Vec3<S> v = so3_log(r);
        worsen(at_pi, std::abs(double(wide(v).norm()) - 3.14159265358979324));
        worsen(at_pi, std::abs(std::abs(first(v[k])) - 3.14159265358979324));
    }
    report.at_most("C11", kind_of<S>(), "exactly pi about x, y, z", f ? 6e-7 : 1e-15, at_pi);
}

template <class T>
void c14(Report& report) {
    // No eigenvector is differentiated: an isotropic Gaussian's matrix has a smooth derivative.
    using D = Dual<T, 1>;
    Vec3<D> x(D(T(1)), D(T(0)), D(T(0))), y(D(T(0)), D(T(1)), D(T(0)));
    x[0].d[0] = T(1);
    const detail::PrecisionFactor<D> f = detail::precision_factor(x, y, D(T(0.3)));
    report.holds("C14", kind_of<T>(), "isotropic: derivatives of the factor are finite",
                 isfinite(f.k1) && isfinite(f.k2) && isfinite(f.m));
    const T equal = T(1);
    report.textbook_fails("C14", kind_of<T>(), "1 / (lambda_1 - lambda_2) of equal eigenvalues",
                          std::isfinite(T(1) / (equal - equal)));
}

} // namespace

void rotations(Report& report) {
    every_scalar([&]<class S>() {
        c1_c3<S>(report);
        c5<S>(report);
        c9<S>(report);
        c10_c11<S>(report);
    });
    const auto both = [&]<class T>() {
        c2_c3<T>(report);
        c4_c12<T>(report);
        c14<T>(report);
    };
    both.operator()<float>();
    both.operator()<double>();
}

} // namespace rye::hard
