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
    return detail::dot_product_test(
        f, [&](const Columns<double>& g) { return vjp(g); }, x, dx, w);
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
            SeenThroughGradient<double> sum{V::Zero(), 0};
            const V g_point = seen_through_vjp({c, 1.336}, camera, iris, V(g), sum);
            Columns<double> r(3, 2);
            r << sum.camera, g_point;
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

TEST_CASE("refraction: the cotangent of the index is its duals', and that of finite differences") {
    const Cornea<double> c = cornea();
    struct Index1 {};
    using D = Dual<double, 1, Index1>;
    int seen = 0, rim = 0;
    for (const double aside : {0.0, 0.5, 1.0, 1.5, 2.2})
        for (int k = 0; k < 40; ++k) {
            const double r = 0.0015 * k, a = 2.4 * k, index = 1.05 + 0.01 * k;
            const V camera(9 * std::sin(aside), 0.7, 9 * std::cos(aside)),
                iris(r * std::cos(a), r * std::sin(a), 0.1), g(0.7, -0.4, 0.9);
            const Vec3<D> by = seen_through<D>({lifted<D>(c), D::variable(index, 0)},
                                               camera.cast<D>(), iris.cast<D>());
            const double dual = g[0] * by[0].d[0] + g[1] * by[1].d[0] + g[2] * by[2].d[0];
            const auto at = [&](double n) {
                return g.dot(seen_through<double>({c, n}, camera, iris));
            };
            SeenThroughGradient<double> sum{V::Zero(), 2.5};
            seen_through_vjp<double>({c, index}, camera, iris, g, sum);
            CHECK(sum.index - 2.5 == doctest::Approx(dual).epsilon(1e-9));
            const bool lit =
                sphere_path(V(camera - c.centre), V(iris - c.centre), {c.radius, index}).seen;
            (lit ? seen : rim) += 1;
            if (lit && std::abs(dual) > 1e-3)
                CHECK(sum.index - 2.5 ==
                      doctest::Approx((at(index + 1e-5) - at(index - 1e-5)) / 2e-5).epsilon(1e-5));
            if (!lit) CHECK(sum.index == 2.5);
        }
    CHECK(seen > 100);
    CHECK(rim > 10);
    SeenThroughGradient<double> sum{V::Zero(), 0};
    seen_through_vjp<double>({c, 1.0}, V(1, 0, 9), V(0.03, 0, 0.1), V(1, 1, 1), sum);
    CHECK(sum.index == 0);
}

TEST_CASE("highlight: what the cornea mirrors is what a mirror of a sphere does, and it fades") {
    const Cornea<double> c = cornea();
    const V camera(0.5, 0.2, 10), point(0.02, 0.01, 0.1);
    const Mirrored<double> m = mirrored(c, camera, point);
    CHECK(m.strength == 1);
    CHECK(m.to.norm() == doctest::Approx(1).epsilon(1e-13));
    // The same path by Fermat's principle, with a light far along that direction.
    const V q = sphere_path(V(camera - c.centre), V(1e7 * m.to), {c.radius, 1.0}).at;
    const V ray = (q + c.centre - camera).normalized();
    CHECK(cross(ray, V((point - camera).normalized())).norm() < 1e-8);
    // Constant along the camera's ray.
    const V deeper = point + 0.03 * (point - camera).normalized();
    CHECK((mirrored(c, camera, deeper).to - m.to).norm() < 1e-12);
    // In float from 100 units away as in double.
    const Cornea<float> narrow = lifted<float>(c);
    const V far(30, 10, 95);
    const auto near = mirrored(narrow, Vec3<float>(far.cast<float>()),
                               Vec3<float>(point.cast<float>()));
    CHECK((near.to.cast<double>() - mirrored(c, far, point).to).norm() < 2e-6);
    CHECK(mirrored(c, V(0, 0, 0.06), point).strength == 0);          // a camera in the eye
    CHECK(mirrored(c, camera, V(0.11, 0, 0.02)).strength == 0);      // a ray beside the cornea
    CHECK(mirrored(c, V(0, 5, -8), V(0, 0.07, 0.08)).strength == 0); // off the cap
    double last = 1, step = 0;
    for (double x = 0; x < 0.09; x += 1e-4) { // without a jump
        const double now = mirrored(c, camera, V(x, 0, 0.1)).strength;
        step = std::max(step, std::abs(now - last));
        last = now;
    }
    CHECK(last == 0);
    CHECK(step < 0.03);
    const V light = V(-0.3, 0.4, 0.9).normalized();
    CHECK(light_lobe(light, light, 0.1) == 1);
    const V aside = (light + 0.1 * V(0.9, 0, 0.3).normalized()).normalized();
    const double angle = std::acos(aside.dot(light));
    CHECK(light_lobe(aside, light, 0.1) ==
          doctest::Approx(std::exp(-angle * angle / 0.02)).epsilon(1e-3));
}

TEST_CASE("highlight: its vjp is the transpose of its duals, in the middle and where it fades") {
    const Cornea<double> c = cornea();
    const Random random{6, 0};
    std::uint64_t k = 0;
    double worst = 0;
    int seen = 0, fading = 0;
    for (int trial = 0; trial < 3000; ++trial) {
        const auto draw = [&] { return random.normal(k++); };
        V camera = V(draw(), draw(), 1 + std::abs(draw())).normalized();
        camera *= std::exp(1 + draw());
        const V point(0.05 * draw(), 0.05 * draw(), 0.1 + 0.01 * draw());
        const V light = V(draw(), draw(), 1 + draw()).normalized();
        const Mirrored<double> m = mirrored(c, camera, point);
        if (!(m.strength > 0)) continue;
        ++seen;
        fading += m.strength < 1 ? 1 : 0;
        const auto f = [&](const auto& x) {
            using T = typename std::decay_t<decltype(x)>::Scalar;
            const Mirrored<T> n =
                mirrored(lifted<T>(c), Vec3<T>(x.col(0)), Vec3<T>(x.col(1)));
            Columns<T> y(1, 1);
            y(0, 0) = n.strength * light_lobe(n.to, Vec3<T>(light.template cast<T>()), T(0.7));
            return y;
        };
        const auto vjp = [&](const Columns<double>& g) {
            const double lobe = light_lobe(m.to, light, 0.7);
            V g_camera = V::Zero();
            const V g_point = mirrored_vjp<double>(
                c, camera, point,
                {V(g(0, 0) * m.strength * lobe / (0.7 * 0.7) * light), g(0, 0) * lobe}, g_camera);
            Columns<double> r(3, 2);
            r << g_camera, g_point;
            return r;
        };
        worst = std::max(worst, gap(f, vjp, camera, point, std::uint64_t(trial), 1));
    }
    MESSAGE("seen " << seen << ", fading " << fading << ": " << worst);
    CHECK(seen > 500);
    CHECK(fading > 100);
    CHECK(worst < 1e-9);
}
