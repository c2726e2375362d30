// SPDX-License-Identifier: Apache-2.0
// Refraction and reflection at a sphere against brute-force ray tracing.
#include <rye/geometry/sphere_path.hpp>

#include <numbers>
#include <vector>

#include <doctest/doctest.h>

#include <rye/core/random.hpp>

using namespace rye;

namespace {

using V = Vec3<double>;

struct Draws {
    Random random;
    std::uint64_t k = 0;
    double uniform(double a, double b) { return a + (b - a) * random.uniform(k++); }
    V direction() {
        V d(random.normal(k), random.normal(k + 1), random.normal(k + 2));
        k += 3;
        return d.normalized();
    }
};

/// The direction behind a surface of normal n (unit, towards where d comes from), by Snell.
V refracted(const V& d, const V& n, double ratio) {
    const double c = -d.dot(n);
    const V across = ratio * (d + c * n);
    return across - std::sqrt(std::max(0.0, 1 - across.squaredNorm())) * n;
}

/// Angles in the plane of eye and source at which a refracted ray of the eye passes the source:
/// found by a scan of all rays that hit the sphere, then by bisection.
std::vector<double> traced(double distance, const Vec2<double>& source, double radius,
                           double index) {
    const double horizon = std::acos(radius / distance);
    const auto side = [&](double t) {  // side of the refracted ray on which the source is
        const V q(radius * std::cos(t), radius * std::sin(t), 0), eye(distance, 0, 0);
        const V r = refracted((q - eye).normalized(), q / radius, 1 / index);
        return r[0] * (source[1] - q[1]) - r[1] * (source[0] - q[0]);
    };
    std::vector<double> found;
    constexpr int steps = 20000;
    for (int k = 0; k < steps; ++k) {
        double a = horizon * (2.0 * k / steps - 1), b = horizon * (2.0 * (k + 1) / steps - 1);
        double sa = side(a);
        if (sa * side(b) > 0) continue;
        for (int i = 0; i < 60; ++i) {
            const double m = 0.5 * (a + b);
            if (sa * side(m) <= 0)
                b = m;
            else
                a = m, sa = side(m);
        }
        found.push_back(0.5 * (a + b));
    }
    return found;
}

double angle_of(const V& at, const V& eye, const V& source) {
    const V a = eye.normalized(), across = source - a * a.dot(source);
    const V e = across.norm() > 0 ? V(across.normalized()) : V(V::Zero());
    return std::atan2(at.dot(e), at.dot(a));
}

} // namespace

TEST_CASE("refraction: the rays that a brute-force trace finds, and no other") {
    Draws d{{1, 1}};
    double worst = 0;
    int seen = 0, hidden = 0;
    for (int trial = 0; trial < 150; ++trial) {
        const double radius = 0.078, index = trial % 3 == 0 ? 1.376 : 1.336;
        const V eye = d.direction() * d.uniform(0.3, 40);
        // Behind the surface, like an iris: by 0 to half of the radius.
        const V source = d.direction() * radius * d.uniform(0.5, 0.9999);
        const double along = source.dot(eye.normalized());
        const double across = (source - along * eye.normalized()).norm();
        const auto rays =
            traced(eye.norm(), Vec2<double>(along, across), radius, index);
        const SpherePath<double> p = sphere_path(eye, source, {radius, index});
        CHECK(p.at.norm() == doctest::Approx(radius).epsilon(1e-13));
        if (rays.empty()) {
            CHECK_FALSE(p.seen);
            CHECK(p.at.dot(eye) == doctest::Approx(radius * radius).epsilon(1e-9));
            ++hidden;
        } else if (rays.size() == 1) {
            CHECK(p.seen);
            worst = std::max(worst, std::abs(angle_of(p.at, eye, source) - rays[0]));
            ++seen;
        } else {  // beyond a caustic there are several solutions
            double near = 9;
            for (const double r : rays)
                near = std::min(near, std::abs(angle_of(p.at, eye, source) - r));
            CHECK((near < 1e-9 || !p.seen));
        }
    }
    MESSAGE("seen " << seen << ", not " << hidden << ", farthest from the trace " << worst);
    CHECK(seen > 50);
    CHECK(hidden > 10);
    CHECK(worst < 1e-9);
}

TEST_CASE("reflection: equal angles in one plane; seen as long as both see the place") {
    Draws d{{2, 1}};
    double worst = 0;
    int seen = 0;
    for (int trial = 0; trial < 5000; ++trial) {
        const double radius = 0.078;
        const V eye = d.direction() * std::exp(d.uniform(-2.5, 4)),
                light = d.direction() * std::exp(d.uniform(-2.5, 4));
        if (eye.norm() < 1.001 * radius || light.norm() < 1.001 * radius) continue;
        const SpherePath<double> p = sphere_path(eye, light, {radius, 1.0});
        const double apart =
            std::acos(std::clamp(eye.normalized().dot(light.normalized()), -1.0, 1.0));
        const double reach = std::acos(radius / eye.norm()) + std::acos(radius / light.norm());
        if (std::abs(apart - reach) < 1e-6) continue;
        CHECK(p.seen == (apart < reach));
        CHECK(p.at.allFinite());
        if (!p.seen) continue;
        ++seen;
        const V n = p.at / radius;
        const V in = (eye - p.at).normalized(), out = (light - p.at).normalized();
        // The bisector of both is the normal: along the surface they cancel.
        const V both = in + out;
        worst = std::max(worst, (both - n * n.dot(both)).norm());
    }
    CHECK(seen > 1000);
    CHECK(worst < 1e-12);
}

TEST_CASE("on the axis, at the surface and at grazing, in float too") {
    const auto check = [](auto one) {
        using T = decltype(one);
        const T r = T(0.078), n = T(1.336);
        const T tight = std::is_same_v<T, double> ? T(1e-13) : T(1e-5);
        const Vec3<T> eye(T(0), T(0), T(10));
        for (const T off : {T(0), T(1e-30), T(1e-12), T(1e-7)}) {
            const auto p = sphere_path(eye, Vec3<T>(off, T(0), T(0.04)), {r, n});
            CHECK(p.seen);
            CHECK(std::abs(p.at[0]) <= T(2) * off);
            CHECK(std::abs(p.at[2] - r) <= tight * r + off * off / r);
            // Behind the centre, too.
            CHECK(sphere_path(eye, Vec3<T>(off, T(0), T(-0.01)), {r, n}).at.allFinite());
        }
        for (const T angle : {T(0), T(0.3), T(1), T(1.5)}) {  // a source on the surface is Q itself
            const Vec3<T> x(r * std::sin(angle), T(0), r * std::cos(angle));
            for (const T depth : {T(0), T(1e-7), T(1e-3)}) {
                const Vec3<T> source = x * (T(1) - depth);
                const auto p = sphere_path(eye, source, {r, n});
                CHECK(p.at.allFinite());
                CHECK((p.at - source).norm() <= T(40) * r * (depth + tight));
            }
        }
        // A mirror with the light at the camera, straight behind it, and beside it.
        for (const Vec3<T>& light :
             {eye, Vec3<T>(eye * T(3)), Vec3<T>(eye + Vec3<T>(T(1e-7), T(0), T(0)))}) {
            const auto p = sphere_path(eye, light, {r, T(1)});
            CHECK(p.seen);
            CHECK((p.at - Vec3<T>(T(0), T(0), r)).norm() <= tight * T(10) * r + T(1e-9));
        }
        const auto behind = sphere_path(eye, Vec3<T>(-eye), {r, T(1)});
        CHECK_FALSE(behind.seen);
        CHECK(behind.at.allFinite());
    };
    check(1.0);
    check(1.0F);
}

TEST_CASE("float paths are those of double") {
    Draws d{{3, 1}};
    double worst = 0;
    for (int trial = 0; trial < 3000; ++trial) {
        const V eye = d.direction() * d.uniform(1, 20);
        const V source = d.direction() * d.uniform(0.03, 0.0779);
        const Vec3<float> e = eye.cast<float>(), s = source.cast<float>();
        const auto p = sphere_path<double>(e.cast<double>(), s.cast<double>(),
                                           {double(0.078F), double(1.336F)});
        const auto q = sphere_path(e, s, {0.078F, 1.336F});
        CHECK(q.at.allFinite());
        // Beyond a caustic or at the rim rounding decides whether Q is visible.
        if (p.seen != q.seen) continue;
        const auto along = p.at.normalized().dot(eye.normalized());
        if (along < 0.3 || source.dot(eye) < 0.3 * source.norm() * eye.norm()) continue;
        worst = std::max(worst, (q.at.cast<double>() - p.at).norm() / 0.078);
    }
    MESSAGE("float against double, over the radius: " << worst);
    CHECK(worst < 1e-5);
}
