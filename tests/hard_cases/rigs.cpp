// SPDX-License-Identifier: Apache-2.0
// Gaze, the eye's motion, and the influence of drivers (C6-C8, C15, C16, D1-D8).
#include <limits>

#include <rye/autodiff/dual.hpp>
#include <rye/backend/scalar.hpp>
#include <rye/rig/cornea.hpp>
#include <rye/rig/eye_transform.hpp>
#include <rye/rig/influence.hpp>

#include "report.hpp"

namespace rye::hard {
namespace {

constexpr double degree = 3.14159265358979324 / 180;

template <class T>
void c6_c7(Report& report) {
    const T inf = std::numeric_limits<T>::infinity();
    bool refused = true, taken = true;
    for (const T bad : {T(0), T(1e-30), T(NAN), inf, T(-inf)}) try {
            detail::checked_gaze(Vec3<T>(bad, T(0), T(0)));
            refused = false;
        } catch (const Error&) {}
    for (const T big : {T(1e-5), T(1), T(1e30)})
        taken = taken &&
                std::abs(double(norm(detail::checked_gaze(Vec3<T>(T(0), big, big)))) - 1) < 1e-6;
    report.holds("C6", kind_of<T>(), "gaze 0, 1e-30, NaN, +-inf: Error; 1e-5 to 1e30: unit",
                 refused && taken);
    const Vec3<T> none(T(0), T(0), T(0));
    report.textbook_fails("C6", kind_of<T>(), "g / |g| of the zero gaze",
                          (none / none.norm()).allFinite());
    double worst = 0, naive = 0;
    for (const double off : {1.0, 1e-3, 1e-6, 0.0})
        for (const double side : {1.0, -1.0}) {
            const double p = side * (90 - off) * degree;
            const Vec3<T> g(T(0), static_cast<T>(std::sin(p)), static_cast<T>(std::cos(p)));
            worsen(worst, std::abs(double(pitch_yaw(g)[0]) - p));
            worsen(naive, std::abs(double(std::asin(g[1])) - p));
        }
    const double demanded = sizeof(T) == 4 ? 2e-7 : 5e-16;
    report.at_most("C7", kind_of<T>(), "pitch +-(90 - {1, 1e-3, 1e-6, 0}) deg [rad]", demanded,
                   worst);
    report.textbook("C7", kind_of<T>(), "asin(y) [rad]", demanded, naive);
}

template <class T>
void c8(Report& report) {
    double worst = 0, naive = 0;
    bool exact = true;
    for (const double theta : {90.0, 10.0, 1.0, 0.1, 0.02, 0.01, 0.001, 0.0})
        for (std::uint64_t i = 0; i < 2000; ++i) {
            Vec3<T> a, n;
            for (int k = 0; k < 3; ++k)
                a[k] = static_cast<T>(Random{8, 0}.normal(8 * i + std::uint64_t(k))),
                n[k] = static_cast<T>(Random{8, 3}.normal(8 * i + std::uint64_t(k)));
            a = normalized(a), n = normalized(cross(a, n));
            const double t = theta * degree;
            Vec3<T> b = static_cast<T>(std::cos(t)) * a + static_cast<T>(std::sin(t)) * n;
            if (theta == 0) b = a;
            // For the given vectors, in long double.
            const Vec3<long double> p = a.template cast<long double>(),
                                    q = b.template cast<long double>();
            const long double truth = std::atan2(cross(p, q).norm(), dot(p, q));
            const auto off = [&](T x) { return std::abs(double(x - truth)) / degree; };
            worsen(worst, off(angular_error(a, b)));
            worsen(naive, off(std::acos(std::clamp(dot(a, b), T(-1), T(1)))));
            exact = exact && (theta != 0 || angular_error(a, b) == T(0)) &&
                    angular_error(a, b) == angular_error(b, a);
        }
    const double demanded = sizeof(T) == 4 ? 2e-5 : 4e-14;
    report.at_most("C8", kind_of<T>(), "angles 90 to 0.001 deg, 2000 pairs each [deg]", demanded,
                   worst);
    report.holds("C8", kind_of<T>(), "equal: exactly 0; symmetric", exact);
    report.textbook("C8", kind_of<T>(), "acos(a . b) [deg]", demanded, naive);
}

/// An eye on +x at a distance, a source inside the unit sphere in the plane z = 0.
template <class T>
void c16(Report& report) {
    double off = 0, snell = 0, textbook = 0;
    for (const double distance : {1.5, 10.0, 100.0, 1000.0, 10000.0})
        for (const double index : {1.376, 1 / 1.376})
            for (double angle = 0; angle < 1.2; angle += 0.05) {
                const Vec3<T> eye(T(distance), T(0), T(0));
                const Vec3<T> source(T(0.6 * std::cos(angle)), T(0.6 * std::sin(angle)), T(0));
                const SpherePath<T> path = sphere_path(eye, source, {T(1), T(index)});
                if (!path.seen) continue;
                const Vec3<double> q = path.at.template cast<double>();
                const Vec3<double> out = eye.template cast<double>() - q;
                const Vec3<double> in = source.template cast<double>() - q;
                worsen(off, std::abs(q.norm() - 1));
                worsen(snell, std::abs(double(T(index)) * norm(cross(in, q)) / in.norm() -
                                       norm(cross(out, q)) / out.norm()));
                // The same ray meets the sphere by the roots of a quadratic.
                const Vec3<T> d = normalized(Vec3<T>(path.at - eye));
                const T b = dot(eye, d), c = dot(eye, eye) - T(1);
                const Vec3<T> hit = eye + d * T(-b - std::sqrt(std::max(T(0), T(b * b - c))));
                worsen(textbook, std::abs(hit.template cast<double>().norm() - 1));
            }
    const double u = sizeof(T) == 4 ? 6e-8 : 1.2e-16;
    report.at_most("C16", kind_of<T>(), "eye at 1.5 to 10000 radii: off the sphere", 4 * u, off);
    report.at_most("C16", kind_of<T>(), "index 1.376 both ways: n sin - sin", 32 * u, snell);
    report.textbook("C16", kind_of<T>(), "-b - sqrt(b^2 - c)", 4 * u, textbook);

    // Sources whose light leaves along the surface, +-1e-7, and beyond.
    bool finite = true, sides = true;
    double jump = 0;
    const double distance = 20, rim = std::acos(1 / distance), bend = std::asin(1 / 1.376);
    for (const double depth : {1e-3, 0.1, 0.3}) {
        Vec3<double> before = Vec3<double>::Zero();
        for (const double grazing : {-1e-7, 0.0, 1e-7, 1e-2}) {
            // From the rim inwards, at more than the angle of total reflection.
            const double a = rim + 3.14159265358979324 - (bend + grazing);
            const Vec3<T> source(T(std::cos(rim) + depth * std::cos(a)),
                                 T(std::sin(rim) + depth * std::sin(a)), T(0));
            const SpherePath<T> path =
                sphere_path(Vec3<T>(T(distance), T(0), T(0)), source, {T(1), T(1.376)});
            finite = finite && path.at.allFinite();
            if (grazing < 0 && sizeof(T) == 8) sides = sides && path.seen != (grazing > 0);
            if (grazing == 1e-2) sides = sides && !path.seen;
            const Vec3<double> now = path.at.template cast<double>();
            if (grazing > -1e-7 && grazing < 1e-2) worsen(jump, (now - before).norm());
            before = now;
        }
    }
    report.holds("C16", kind_of<T>(), "total reflection +-1e-7: finite, distinguished",
                 finite && sides);
    report.at_most("C16", kind_of<T>(), "... and no jump there", 1e-5, jump);
    report.textbook_fails("C16", kind_of<T>(), "sqrt(1 - n^2 sin^2) beyond total reflection",
                          std::isfinite(std::sqrt(T(1) - square(T(1.376) * T(0.8)))));
}

template <class T>
void c15(Report& report) {
    // Kappa, then gaze, then offset, then head: angles 5, 30, 20 deg and 2 mm, by hand.
    const auto about = [](int axis, double deg) {
        Vec3<double> w(0, 0, 0);
        w[axis] = deg * degree;
        return so3_exp(w);
    };
    const Mat3<double> head = about(1, 20);
    EyeDrive<T> drive;
    drive.centre = Vec3<T>(T(0.3), T(0.1), T(0.8));
    drive.offset = Vec3<T>(T(0.02), T(0), T(0));
    const Vec3<double> visual = gaze_vector(-30 * degree, 0.0);
    drive.gaze = apply_kappa(Vec3<T>(visual.cast<T>()), KappaAngles<T>{T(0), T(5 * degree)});
    HeadPlacement<T> place;
    place.world_from_head = {Mat3<T>(head.cast<T>()), Vec3<T>(T(1), T(2), T(3))};
    const Vec3<T> x(T(0.01), T(-0.02), T(0.12));
    const Vec3<T> got = eye_transform(drive, place).apply(x);
    const Vec3<double> optical = gaze_vector(-30 * degree, 5 * degree);
    const Mat3<double> turn = quat_matrix(shortest_arc(Vec3<double>(0, 0, 1), optical));
    const Vec3<double> centre(0.32, 0.1, 0.8), move(1, 2, 3), p = x.template cast<double>();
    const Vec3<double> truth = head * (centre + turn * p) + move;
    const auto off = [&](const Vec3<double>& y) { return (y - truth).cwiseAbs().maxCoeff(); };
    report.at_most("C15", kind_of<T>(), "30 deg gaze, 20 deg head, 5 deg kappa, 2 mm offset", 1e-6,
                   off(got.template cast<double>()));
    report.textbook("C15", kind_of<T>(), "gaze after head", 1e-6,
                    off(turn * (head * p) + head * centre + move));
    report.textbook("C15", kind_of<T>(), "eye turned about the head's origin", 1e-6,
                    off(head * (turn * (p + centre)) + move));
}

template <class M, class T>
void d_metric(Report& report, const char* metric) {
    const std::string kind = kind_of<T>() + ", " + metric;
    const bool squared = std::is_same_v<M, SquaredDistance>;
    const auto arg = [&](double d) { return squared ? static_cast<T>(d) : static_cast<T>(d * d); };
    const M m;
    // D1: a ramp without width is a step.
    const Ramp<T> step{T(0.25), T(0.25)};
    const T t = squared ? T(0.25) : T(0.25) * T(0.25), below = std::nextafter(t, T(0));
    const Ramp<T> thin{T(0.25), std::nextafter(T(0.25), T(1))};
    report.holds("D1", kind, "t1 = t2: 1 below, 0 from t on, slope 0; next float apart: finite",
                 m.value(step, below) == T(1) && m.value(step, t) == T(0) &&
                     m.slope(step, t) == T(0) && m.slope(step, below) == T(0) &&
                     std::isfinite(m.value(thin, t)));
    bool thrown = true;
    for (const auto& [a, b] : {std::pair<T, T>{T(2), T(1)}, {T(-1), T(1)}, {T(NAN), T(1)}}) try {
            detail::checked_ramp<T>(a, b);
            thrown = false;
        } catch (const Error&) {}
    report.holds("D1", kind, "t1 > t2, negative, NaN: Error", thrown);
    const T zero = T(0);
    report.textbook_fails("D1", kind, "(t2 - d) / (t2 - t1) of no width",
                          std::isfinite(zero / zero));
    // D2: the kinks.
    const Ramp<T> r{T(0.15), T(0.25)};
    bool kinks = true;
    for (const double k : {0.15, 0.25})
        for (const double side : {1 - 1e-3, 1 + 1e-3}) {
            const bool inside = k * side > 0.15 && k * side < 0.25;
            const double slope = double(m.slope(r, arg(k * side)));
            const double truth = squared ? -10.0 : -5.0 / (k * side);
            kinks = kinks && std::abs(slope - (inside ? truth : 0.0)) < 1e-4 * std::abs(truth);
        }
    if (squared) kinks = kinks && m.slope(r, r.near) == T(0) && m.slope(r, r.far) == T(0);
    report.holds("D2", kind, "slopes at {t1, t2}(1 -+ 1e-3), 0 at the kinks and outside", kinks);
    // D3: on the landmark.
    using D = Dual<T, 1>;
    D at(T(0));
    at.d[0] = T(1);
    const D v = m.value(Ramp<D>{D(T(0.15)), D(T(0.25))}, at);
    report.holds("D3", kind, "on a landmark: weight 1, derivative 0",
                 v.value == T(1) && v.d[0] == T(0));
    using std::sqrt;
    report.textbook_fails("D3", kind, "derivative of sqrt at 0", std::isfinite(sqrt(at).d[0]));
    // D5: both metrics at one distance.
    const double d = 0.4, value = double(m.value(r, static_cast<T>(d * d)));
    const double mine = squared ? (0.25 - d * d) / 0.1 : 0.0;
    report.at_most("D5", kind, "d = 0.4, t = (0.15, 0.25)", 1e-6, std::abs(value - mine));
    report.textbook("D5", kind, "the other metric's value there", 1e-6,
                    std::abs(mine - (squared ? 0.0 : (0.25 - d * d) / 0.1)));
    // D6
    double worst = 0;
    for (std::uint64_t i = 0; i < 100000; ++i) {
        const T x = static_cast<T>(0.4 * Random{6, 0}.uniform(i));
        const T l = m.value(r, x), rest = T(1) - l;
        worsen(worst, std::abs(double(l + rest) - 1) / (2 * unit<T>));
    }
    report.at_most("D6", kind, "100000 distances: |l + (1 - l) - 1| [ulp]", 1, worst);
}

template <class B, class T>
void d_landmarks(Report& report, const char* backend) {
    const std::string kind = kind_of<T>() + ", " + backend;
    Columns<T> points(3, 9), marks(3, 2);
    points.setZero();
    marks << T(-1), T(1), T(0), T(0), T(0), T(0);
    std::vector<Index> nearest;
    const auto d = nearest_squared_distance<T>(B{}, points, marks, &nearest);
    bool lowest = d.isOnes(0);
    for (const Index i : nearest) lowest = lowest && i == 0;
    report.holds("D4", kind, "9 points midway between two landmarks: the lowest index", lowest);
    const auto none = nearest_squared_distance<T>(B{}, points, Columns<T>(3, 0), &nearest);
    const Ramp<T> r{T(0.15), T(0.25)};
    bool empty = true;
    for (Index i = 0; i < 9; ++i)
        empty = empty && influence(SquaredDistance(), r, T(none(0, i))) == T(0) &&
                nearest[static_cast<std::size_t>(i)] == -1;
    Columns<T> bad = marks;
    bad(1, 1) = T(NAN);
    bool told = false;
    try {
        nearest_squared_distance<T>(B{}, points, bad);
    } catch (const Error&) {
        told = true;
    }
    Columns<T> far = Columns<T>::Constant(3, 2, T(1e30));
    const auto apart = nearest_squared_distance<T>(B{}, points, far);
    empty = empty && influence(EuclideanDistance(), r, T(apart(0, 0))) == T(0);
    report.holds("D7", kind, "no landmark: 0; a NaN one: Error; at 1e30: 0", empty && told);
    const T inf = std::numeric_limits<T>::infinity();
    report.textbook_fails("D7", kind, "(t2 - d) / (t2 - t1) of no landmark, unclamped",
                          std::isfinite((T(0.25) - inf) / T(0.1)));
}

template <class T>
void d8(Report& report) {
    for (const double gap : {0.2, 0.6}) {
        Columns<T> left(1, 1), right(1, 1);
        const double d2 = gap * gap / 4;
        const Ramp<T> r{T(0.15), T(0.25)};
        left(0, 0) = right(0, 0) = influence(SquaredDistance(), r, T(d2));
        Columns<T> l = left, q = right;
        const T most = detail::resolve_overlap(Overlap::normalized, l, q);
        report.holds("D8", kind_of<T>(),
                     "midway between eyes " + std::string(gap < 0.5 ? "2" : "6") +
                         " cm apart: sum returned, normalised to 1",
                     most == left(0, 0) + right(0, 0) && double(l(0, 0) + q(0, 0)) <= 1 + 1e-7);
        if (gap < 0.5)
            report.textbook("D8", kind_of<T>(), "both added", 1, double(left(0, 0) + right(0, 0)));
    }
}

} // namespace

void rigs(Report& report) {
    const auto both = [&]<class T>() {
        c6_c7<T>(report);
        c8<T>(report);
        c15<T>(report);
        c16<T>(report);
        d_metric<SquaredDistance, T>(report, "squared metric");
        d_metric<EuclideanDistance, T>(report, "plain metric");
        d_landmarks<ScalarBackend<>, T>(report, "scalar backend");
        d_landmarks<XsimdBackend<>, T>(report, "lanes backend");
        d8<T>(report);
    };
    both.operator()<float>();
    both.operator()<double>();
}

} // namespace rye::hard
