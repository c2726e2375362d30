// SPDX-License-Identifier: Apache-2.0
// Projection through a lens with distortion: against duals, against the pinhole for coefficients of
// 0, and against finely sampled Gaussians, distorted point by point.
#include <rye/gaussian/project.hpp>

#include <doctest/doctest.h>

#include <rye/backend/lanes.hpp>
#include <rye/core/random.hpp>

#include "../support/projection_law.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using Lens64 = BrownConrady<double>;
constexpr Lens64 barrel{-0.28, 0.07, -0.008, 1.2e-3, -7e-4};
constexpr Lens64 pincushion{0.2, 0.05, 0.0, -2e-3, 1e-3};

Pinhole<double> tilted() {
    Pinhole<double> c;
    c.fx = 300, c.fy = 320, c.cx = 90, c.cy = 20, c.width = 128, c.height = 100;
    c.camera_from_world.rotation = so3_exp(Vec3<double>(0.3, -0.2, 0.5));
    c.camera_from_world.translation = Vec3<double>(0.1, 0.2, 4);
    return c;
}

/// Mean and covariance on the screen of a Gaussian's density, by quadrature: its points are
/// projected one by one. Nodes and weights are those of five points an axis, exact to degree 9.
struct Moments {
    Vec2<double> centre = Vec2<double>::Zero();
    Sym2<double> covariance{0, 0, 0};
};
template <class C>
Moments sampled(const Shape<double>& s, const C& camera) {
    // Gauss-Hermite for exp(-x^2 / 2): roots 0, +-1.3556..., +-2.8569...
    const double x[5] = {-2.856970013872806, -1.355626179974266, 0, 1.355626179974266,
                         2.856970013872806};
    const double w[5] = {0.011257411327721, 0.222075922005613, 0.533333333333333,
                         0.222075922005613, 0.011257411327721};
    const Mat3<double> r = quat_matrix(quat_normalized(s.rotation));
    Moments m;
    double sum = 0;
    for (const bool centred : {false, true}) {
        for (int i = 0; i < 5; ++i)
            for (int j = 0; j < 5; ++j)
                for (int k = 0; k < 5; ++k) {
                    const Vec3<double> at(x[i] * s.scale[0], x[j] * s.scale[1], x[k] * s.scale[2]);
                    const Vec3<double> p = camera.project_point(Vec3<double>(s.mean + r * at));
                    const double weight = w[i] * w[j] * w[k];
                    if (!centred) {
                        m.centre += weight * p.head<2>();
                        sum += weight;
                        continue;
                    }
                    const Vec2<double> e(p.head<2>() - m.centre);
                    m.covariance.xx += weight * e[0] * e[0];
                    m.covariance.xy += weight * e[0] * e[1];
                    m.covariance.yy += weight * e[1] * e[1];
                }
        if (!centred) m.centre /= sum;
    }
    return m;
}

/// Error of the first-order Gaussian against the sampled one: of the centre [px], and of the
/// covariance, relative.
template <class C>
Vec2<double> error(const Shape<double>& s, const C& camera) {
    const auto p = project(s, Projector(camera, 10.0, 0.0));
    const Moments m = sampled(s, camera);
    const Vec2<double> off(p.centre + Vec2<double>(camera.cx, camera.cy) - m.centre);
    const double size = m.covariance.xx + m.covariance.yy;
    return Vec2<double>(off.norm(), (std::abs(p.covariance.xx - m.covariance.xx) +
                                     2 * std::abs(p.covariance.xy - m.covariance.xy) +
                                     std::abs(p.covariance.yy - m.covariance.yy)) / size);
}

} // namespace

TEST_CASE("a bent projection's vjp is the transpose of its duals, beyond the limits too") {
    Draws d{{21, 1}};
    double worst = 0;
    int drawn = 0;
    for (int i = 0; i < 3000; ++i) {
        const auto camera = with_lens(tilted(), i % 2 == 0 ? barrel : pincushion);
        const double margin = i % 3 == 0 ? -0.5 : 0.3;  // half of the image is beyond the limits
        const Shape<double> s = random_shape(d, 0.6);
        drawn += project(s, Projector(camera, margin, 0.3)).drawable ? 1 : 0;
        worst = std::max(worst, gap<Antialias::dilate>(s, camera, margin, d));
        worst = std::max(worst, gap<Antialias::mip>(s, camera, margin, d));
    }
    CHECK(drawn > 2000);
    CHECK(worst < 1e-12);
}

TEST_CASE_TEMPLATE("without coefficients a lens is the pinhole: 0 ulps in double, 2 in float", T,
                   float, double) {
    Draws d{{22, 1}};
    const Pinhole<T> plain = tilted().cast<T>();
    const auto bent = with_lens(plain, BrownConrady<T>{});
    const Projector a(plain, 0.3, 0.3);
    const Projector b(bent, 0.3, 0.3);
    CHECK(a.x_low == b.x_low);
    CHECK(a.y_high == b.y_high);
    // Relative to the largest intermediate value, which determines the rounding after cancellation.
    const auto ulps = [](const auto& x, const auto& y) {
        const T size = std::max(x.cwiseAbs().maxCoeff(), y.cwiseAbs().maxCoeff());
        const T gap = (x - y).cwiseAbs().maxCoeff();
        return static_cast<double>(gap / (std::nextafter(size, T(INFINITY)) - size));
    };
    double worst = 0;
    for (int i = 0; i < 2000; ++i) {
        const Shape<double> exact = random_shape(d, 0.6);
        const Shape<T> s{exact.mean.cast<T>(), exact.rotation.cast<T>(), exact.scale.cast<T>()};
        const auto p = project(s, a), q = project(s, b);
        CHECK(p.drawable == q.drawable);
        const ScreenCotangent<T> c{Vec2<T>(T(0.3), T(-0.2)), {T(1), T(-0.4), T(0.7)}, T(0.1)};
        const Shape<T> g = project_vjp(s, a, c), h = project_vjp(s, b, c);
        const Vec3<T> forms(p.precision.k1, p.precision.m, p.determinant),
            others(q.precision.k1, q.precision.m, q.determinant);
        for (const double x : {ulps(p.centre, q.centre), ulps(forms, others), ulps(g.mean, h.mean),
                               ulps(g.rotation, h.rotation), ulps(g.scale, h.scale)})
            worst = std::max(worst, x);
    }
    MESSAGE("ulps apart: " << worst);
#ifdef __clang__ // fuses products and sums differently in the two places
    CHECK(worst <= 8);
#else
    CHECK(worst == 0);
#endif
}

TEST_CASE("a bent Gaussian against one whose points are bent: the error falls with its variance") {
    for (const Lens64& lens : {barrel, pincushion}) {
        const auto bent = with_lens(tilted(), lens);
        Draws d{{23, 1}};
        Vec2<double> last = Vec2<double>::Zero(), pinhole = last;
        for (const double size : {0.04, 0.02, 0.01}) {
            Vec2<double> most = Vec2<double>::Zero(), straight = most;
            Draws e = d;
            for (int i = 0; i < 200; ++i) {
                Shape<double> s = random_shape(e, 0.6);
                s.scale = size * s.scale / s.scale.maxCoeff();
                if (!project(s, Projector(bent, 0.3, 0.3)).drawable) continue;
                most = most.cwiseMax(error(s, bent));
                straight = straight.cwiseMax(error(s, tilted()));
            }
            MESSAGE("deviation " << size << " at 4 (" << 310 * size / 4 << " px): centre "
                                 << most[0] << " px, covariance " << most[1]
                                 << "; of the pinhole " << straight[0] << " px, " << straight[1]);
            if (last[0] > 0) {
                CHECK(most[0] < 0.3 * last[0]);   // a quarter
                CHECK(most[1] < 0.3 * last[1]);
            }
            last = most;
            pinhole = straight;
        }
        CHECK(last[0] < 0.01);
        CHECK(last[1] < 2e-3);
        // The approximation is no coarser than the pinhole's own.
        CHECK(last[0] < 2 * pinhole[0]);
        CHECK(last[1] < 2 * pinhole[1]);
        // A pinhole's Jacobian at the distorted point would be far off.
        Shape<double> s{Vec3<double>(0, 0, 0), Quat<double>(1, 0, 0, 0), Vec3<double>(1, 1, 1)};
        s.scale *= 0.01;
        s.mean = bent.camera_from_world.inverse().apply(Vec3<double>(2.2, 1.1, 4));
        CHECK(error(s, bent)[1] < 5e-3);
        const auto q = project(s, Projector(tilted(), 10.0, 0.0));
        const Moments m = sampled(s, bent);
        CHECK(std::abs(q.covariance.xx / m.covariance.xx - 1) > 0.1);
    }
}

TEST_CASE("beyond the fold of a lens nothing is drawn, and its neighbours stay finite") {
    Pinhole<double> c = tilted();
    c.camera_from_world = Rigid<double>();
    const auto bent = with_lens(c, Lens64{-1.0 / 3, 0, 0, 0, 0});  // folds at r = 1
    const Projector lens(bent, 0.3, 0.3);
    const Projector wide(bent.cast<float>(), 0.3, 0.3);
    for (const double r : {0.0, 0.5, 0.9, 0.999999, 1.000001, 1.5, 1.7320508, 10.0, 1e30}) {
        INFO(r);
        const Shape<double> s{Vec3<double>(2 * r, 0, 2), Quat<double>(1, 0, 0, 0),
                              Vec3<double>(0.1, 0.1, 0.1)};
        CHECK(project(s, lens).drawable == (r < 1));
        const Shape<float> f{s.mean.cast<float>(), s.rotation.cast<float>(),
                             s.scale.cast<float>()};
        CHECK(project(f, wide).drawable == (r < 1));
        if (r < 1) {
            const Shape<double> g = project_vjp(
                s, lens, {Vec2<double>(1, 1), {1, 1, 1}, 1});
            CHECK(g.mean.allFinite());
            CHECK(g.scale.allFinite());
        }
    }
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const Shape<double> s{Vec3<double>(nan, 0, 2), Quat<double>(1, 0, 0, 0), Vec3<double>(1, 1, 1)};
    CHECK_FALSE(project(s, lens).drawable);
}

TEST_CASE("a bent projection in lanes is that of one scalar at a time") {
    using V = XsimdBackend<>::batch<float>;
    Draws d{{24, 1}};
    const auto bent = with_lens(tilted().cast<float>(), barrel.cast<float>());
    const Projector lens(bent, 0.3, 0.3);
    const Projector<V, BrownConrady<V>> wide(lens);
    for (int trial = 0; trial < 200; ++trial) {
        const Shape<double> e = random_shape(d, 0.6);
        const Shape<float> s{e.mean.cast<float>(), e.rotation.cast<float>(), e.scale.cast<float>()};
        Shape<V> all;
        for (int i = 0; i < 3; ++i) all.mean[i] = V(s.mean[i]), all.scale[i] = V(s.scale[i]);
        for (int i = 0; i < 4; ++i) all.rotation[i] = V(s.rotation[i]);
        const auto p = project(s, lens);
        const auto q = project(all, wide);
        CHECK(q.drawable.get(0) == p.drawable);
        if (!p.drawable) continue;
        CHECK(q.centre[0].get(0) == doctest::Approx(p.centre[0]).epsilon(1e-5));
        CHECK(q.determinant.get(0) == doctest::Approx(p.determinant).epsilon(1e-4));
    }
}
