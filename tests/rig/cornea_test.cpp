// SPDX-License-Identifier: Apache-2.0
#include <rye/rig/cornea.hpp>

#include <doctest/doctest.h>

#include <rye/autodiff/check.hpp>
#include <rye/core/random.hpp>
#include <rye/rig/eyeball.hpp>

using namespace rye;

namespace {

using V = Vec3<double>;

Cornea<double> cornea() { return {V(0, 0, 0.056), 0.078, V(0, 0, 1), 0.1045}; }

template <class T>
Cornea<T> lifted(const Cornea<double>& c) {
    return {c.centre.template cast<T>(), T(c.radius), c.axis.template cast<T>(), T(c.rim)};
}

/// The camera in column 0, then the other point; and outputs of `f`.
template <class F, class Vjp>
double gap(const F& f, const Vjp& vjp, const V& camera, const V& other, std::uint64_t seed,
           Index outputs) {
    Columns<double> x(3, 2);
    x << camera, other;
    const Columns<double> dx = random_columns<double>(3, 2, Random{seed, 1});
    const Columns<double> w = random_columns<double>(outputs, 1, Random{seed, 2});
    return dot_product_test(f, [&](const Columns<double>& g) { return vjp(g); }, x, dx, w);
}

} // namespace

TEST_CASE("refraction: an index of 1 changes no bit, nor does a point in front of the cornea") {
    const Cornea<double> c = cornea();
    const V camera(1, 0.4, 9), iris(0.03, -0.02, 0.1);
    CHECK(seen_through({c, 1.0}, camera, iris) == iris);
    CHECK(seen_through({c, 1.336}, camera, V(0.1, 0, 0.06)) == V(0.1, 0, 0.06));
    const V on = c.centre + V(0, 0.6, 0.8) * (c.radius * (1 + 1e-15));
    CHECK((seen_through({c, 1.336}, camera, on) - on).norm() < 1e-15);
    CHECK(seen_through({c, 1.336}, V(0, 0, 0.06), iris) == iris);  // a camera within it
    // An index near 1 changes little.
    CHECK((seen_through({c, 1 + 1e-9}, camera, iris) - iris).norm() < 1e-9);
}

TEST_CASE("refraction: an iris looks nearer and larger, by the known amounts") {
    const Cornea<double> c = cornea();
    const V camera(0, 0, 1000);
    // Apex at 0.134; an iris 0.036 behind it. Paraxial: the lateral magnification of a surface is
    // n s' / s with n / s = 1 / s' + (n - 1) / R for a distant camera.
    const double s = 0.036, n = 1.336, virtual_depth = 1 / (n / s - (n - 1) / 0.078);
    const double magnification = n * virtual_depth / s;
    const V iris(1e-4, 0, 0.134 - s), at = seen_through({c, n}, camera, iris);
    CHECK(at[0] / iris[0] == doctest::Approx(magnification).epsilon(1e-3));
    CHECK(magnification > 1.1);
    CHECK(at[2] == doctest::Approx(iris[2]).epsilon(1e-5));   // the same distance behind the apex
}

TEST_CASE("refraction: below the index of `droppable` no iris is moved by as much as is seen") {
    const EyeballShape shape{.iris_plane = 0.1};
    const Cornea<double> c{V(0, 0, shape.cornea_offset), shape.cornea_radius, V(0, 0, 1),
                           shape.limbus_plane()};
    const double index = 1 + CornealRefraction::droppable.most;
    double most = 0;
    for (double aside = 0; aside < 1.2; aside += 0.1)
        for (double r = 0; r < shape.limbus_radius; r += 0.002)
            for (double a = 0; a < 6.28; a += 0.3) {
                const V iris(r * std::cos(a), r * std::sin(a), shape.iris(r));
                const V camera(9 * std::sin(aside), 0, 9 * std::cos(aside));
                most = std::max(most, (seen_through({c, index}, camera, iris) - iris).norm());
            }
    MESSAGE("moved by " << most << " at an index of " << index);
    CHECK(most > 0.1 * least_move);
    CHECK(most < least_move);
}

TEST_CASE("refraction: its vjp is the transpose of its duals, on the axis and at the rim too") {
    const Cornea<double> c = cornea();
    const Random random{5, 0};
    std::uint64_t k = 0;
    double worst = 0, rim = 0;
    int seen = 0, hidden = 0;
    for (int trial = 0; trial < 2000; ++trial) {
        const auto draw = [&] { return random.normal(k++); };
        V camera = V(draw(), draw(), 0.3 + std::abs(draw())).normalized() * std::exp(1 + draw());
        if (trial % 7 == 0) camera = V(1e-9, 0, 8);
        V iris(0.05 * draw(), 0.05 * draw(), 0.1);
        if (trial % 5 == 0) iris = V(0, 0, 0.098);
        const V p = iris - c.centre, e = camera - c.centre;
        if (!(p.norm() < c.radius) || !(e.norm() > 1.2 * c.radius)) continue;
        const bool lit = sphere_path(e, p, {c.radius, 1.336}).seen;
        (lit ? seen : hidden) += 1;
        const auto f = [&](const auto& x) {
            using T = typename std::decay_t<decltype(x)>::Scalar;
            const Vec3<T> y = seen_through({lifted<T>(c), T(1.336)}, Vec3<T>(x.col(0)),
                                           Vec3<T>(x.col(1)));
            return Columns<T>(y);
        };
        const auto vjp = [&](const Columns<double>& g) {
            V g_camera = V::Zero();
            const V g_point = seen_through_vjp({c, 1.336}, camera, iris, V(g), g_camera);
            Columns<double> r(3, 2);
            r << g_camera, g_point;
            return r;
        };
        (lit ? worst : rim) = std::max(lit ? worst : rim,
                                       gap(f, vjp, camera, iris, std::uint64_t(trial), 3));
    }
    MESSAGE("seen " << seen << ": " << worst << "; on the rim " << hidden << ": " << rim);
    CHECK(seen > 500);
    CHECK(hidden > 20);
    CHECK(worst < 1e-9);
    CHECK(rim < 1e-9);
}

TEST_CASE("glint: strongest at Alhazen's point, nothing beyond the limbus or behind the eye") {
    const Cornea<double> c = cornea();
    const V camera(0.5, 0.2, 10);
    const GlintView<double> view{camera, V(-3, 4, 9), 0.01};
    const MirrorImage<double> m = mirror_image(c, view);
    CHECK(m.seen);
    CHECK(m.strength == 1);
    CHECK(glint_at(m, view, m.at) == 1);
    const V aside = m.at + V(0, 0.01, 0);
    CHECK(glint_at(m, view, aside) < 0.9);
    // Constant along the camera's ray.
    const V deeper = m.at + 0.03 * (m.at - camera).normalized();
    CHECK(glint_at(m, view, deeper) == doctest::Approx(1).epsilon(1e-12));
    CHECK_FALSE(mirror_image(c, {camera, V(0, 0, -9), 0.01}).seen);
    CHECK_FALSE(mirror_image(c, {V(0, 1, -5), V(0, -1, -5), 0.01}).seen);  // off the cap
    CHECK_FALSE(mirror_image(c, {camera, V(0, 0, 0.06), 0.01}).seen);      // a light in the eye
    double last = 1, step = 0;
    for (double a = 0; a < 2.6; a += 0.002) {  // it fades without a jump
        const V light(9 * std::sin(a), 0, 9 * std::cos(a));
        const double now = mirror_image(c, {camera, light, 0.01}).strength;
        step = std::max(step, std::abs(now - last));
        last = now;
    }
    CHECK(last == 0);
    CHECK(step < 0.05);
}

TEST_CASE("glint: its vjp is the transpose of its duals, in full light and where it fades") {
    const Cornea<double> c = cornea();
    const Random random{6, 0};
    std::uint64_t k = 0;
    double worst = 0;
    int seen = 0, fading = 0;
    for (int trial = 0; trial < 1500; ++trial) {
        const auto draw = [&] { return random.normal(k++); };
        V camera = V(draw(), draw(), 1 + std::abs(draw())).normalized();
        camera *= std::exp(1 + draw());
        V light = V(2 * draw(), 2 * draw(), 1 + draw()).normalized() * std::exp(1 + draw());
        if (trial % 9 == 0) light = camera * 1.5;
        const double width = 0.02;
        const GlintView<double> view{camera, light, width};
        const MirrorImage<double> m = mirror_image(c, view);
        if (!m.seen) continue;
        ++seen;
        fading += m.strength < 1 ? 1 : 0;
        const V point = m.at + 0.02 * V(draw(), draw(), draw());
        const auto f = [&](const auto& x) {
            using T = typename std::decay_t<decltype(x)>::Scalar;
            const GlintView<T> lit{Vec3<T>(x.col(0)), Vec3<T>(x.col(1)), T(width)};
            const auto image = mirror_image(lifted<T>(c), lit);
            Columns<T> y(1, 1);
            y(0, 0) = glint_at(image, lit, Vec3<T>(point.cast<T>()));
            return y;
        };
        const auto vjp = [&](const Columns<double>& g) {
            GlintGradient<double> gradient{{V::Zero(), 0, true}, V::Zero(), V::Zero()};
            glint_at_vjp(m, view, point, g(0, 0) * glint_at(m, view, point), gradient);
            mirror_image_vjp(c, view, m, gradient);
            Columns<double> r(3, 2);
            r << gradient.camera, gradient.light;
            return r;
        };
        worst = std::max(worst, gap(f, vjp, camera, light, std::uint64_t(trial), 1));
    }
    MESSAGE("seen " << seen << ", fading " << fading << ": " << worst);
    CHECK(seen > 300);
    CHECK(fading > 20);
    CHECK(worst < 1e-9);
}
