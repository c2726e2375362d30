// SPDX-License-Identifier: Apache-2.0
#include "synthetic_capture/ray_caster.hpp"

#include <cmath>

#include <doctest/doctest.h>

#include <rye/core/error.hpp>
#include <rye/core/random.hpp>
#include <rye/math/linalg.hpp>

using namespace rye;
using namespace rye::trainer;
using V3 = Vec3<double>;

namespace {

struct Soup {
    Columns<double> vertices;
    std::vector<Face> faces;
};

Soup random_soup(int triangles, double size, std::uint64_t seed) {
    const Random r{seed};
    Soup s;
    s.vertices.resize(3, 3 * triangles);
    for (Index i = 0; i < triangles; ++i) {
        const auto k = static_cast<std::uint64_t>(100 * i);
        for (Index c = 0; c < 3; ++c)
            for (Index d = 0; d < 3; ++d)
                s.vertices(d, 3 * i + c) =
                    r.uniform(k + static_cast<std::uint64_t>(d)) +
                    size * r.normal(k + 10 + static_cast<std::uint64_t>(3 * c + d));
        s.faces.push_back({3 * i, 3 * i + 1, 3 * i + 2});
    }
    return s;
}

/// Every face, by solving for (t, u, v) with Cramer's rule.
Hit brute_force(const Soup& s, const Ray& ray) {
    Hit best;
    for (std::size_t f = 0; f < s.faces.size(); ++f) {
        const V3 a = s.vertices.col(s.faces[f][0]), ab = V3(s.vertices.col(s.faces[f][1])) - a;
        const V3 ac = V3(s.vertices.col(s.faces[f][2])) - a, o = ray.origin - a, d = -ray.direction;
        const auto det = [](const V3& x, const V3& y, const V3& z) { return x.dot(cross(y, z)); };
        const double whole = det(ab, ac, d);
        const double u = det(o, ac, d) / whole, v = det(ab, o, d) / whole,
                     t = det(ab, ac, o) / whole;
        if (u < 0 || v < 0 || u + v > 1 || t < ray.t_min || t > ray.t_max || t >= best.t) continue;
        best = {static_cast<Index>(f), t, u, v};
    }
    return best;
}

V3 random_direction(const Random& r, std::uint64_t k) {
    return normalized(V3(r.normal(k), r.normal(k + 2), r.normal(k + 4)));
}

} // namespace

TEST_CASE("ray caster: agrees with asking every face, on large and on tiny triangles") {
    for (const double size : {0.3, 0.02}) {
        const Soup s = random_soup(700, size, size > 0.1 ? 3 : 4);
        const RayCaster caster(s.vertices, s.faces);
        const Random r{9};
        int met = 0;
        for (std::uint64_t k = 0; k < 3000; ++k) {
            const V3 from(r.uniform(9 * k) * 3 - 1, r.uniform(9 * k + 1), r.uniform(9 * k + 2));
            const Ray ray{from, 2.0 * random_direction(r, 100000 + 9 * k), 0.01, 0.9};
            const Hit hit = caster.nearest(ray), truth = brute_force(s, ray);
            CHECK(hit.face == truth.face);
            CHECK(caster.meets(ray) == static_cast<bool>(truth));
            if (!truth || hit.face != truth.face) continue;
            ++met;
            CHECK(std::abs(hit.t - truth.t) < 1e-11);
            CHECK(std::abs(hit.u - truth.u) + std::abs(hit.v - truth.v) < 1e-8);
        }
        CHECK(met > 100);
    }
}

TEST_CASE("ray caster: four rays together find what each finds alone") {
    const Soup s = random_soup(900, 0.05, 5);
    const RayCaster caster(s.vertices, s.faces);
    const Random r{10};
    int met = 0;
    for (std::uint64_t k = 0; k < 2000; ++k) {
        RayBundle bundle{V3(-2, 0.5, 0.5), {}};
        for (std::uint64_t i = 0; i < 4; ++i)
            bundle.directions[i] =
                V3(1, 0.6 * (r.uniform(4 * k) - 0.5) + 0.01 * r.normal(8 * k + 2 * i),
                   0.6 * (r.uniform(4 * k + 1) - 0.5));
        const std::array<Hit, 4> together = caster.nearest(bundle);
        for (std::size_t i = 0; i < 4; ++i) {
            const Hit alone = caster.nearest(Ray{bundle.origin, bundle.directions[i]});
            CHECK(together[i].face == alone.face);
            if (!alone) continue;
            ++met;
            CHECK(std::abs(together[i].t - alone.t) < 1e-12);
        }
    }
    CHECK(met > 1000);
}

TEST_CASE("ray caster: rays along the axes, in the planes of boxes, and through shared edges") {
    // A unit square in z = 0 of two triangles; their diagonal is shared.
    Soup s;
    s.vertices.resize(3, 4);
    s.vertices << 0, 1, 1, 0, 0, 0, 1, 1, 0, 0, 0, 0;
    s.faces = {{0, 1, 2}, {0, 2, 3}};
    const RayCaster caster(s.vertices, s.faces);
    for (double x = 0; x <= 1.0; x += 0.0625) {
        const Ray down{V3(x, x, 1), V3(0, 0, -1)};
        REQUIRE(caster.nearest(down));
        CHECK(caster.nearest(down).t == 1.0);
        const RayBundle bundle{down.origin,
                               {down.direction, V3(0, -0.0, -2), V3(0, 0, 1), V3(1, 0, 0)}};
        const auto hits = caster.nearest(bundle);
        CHECK(hits[0].t == 1.0);
        CHECK(hits[1].t == 0.5);
        CHECK_FALSE(hits[2]);
        CHECK_FALSE(hits[3]);
    }
    CHECK_FALSE(caster.nearest(Ray{V3(0.5, 0.5, 1), V3(0, 0, 1)}));
    CHECK_FALSE(caster.meets(Ray{V3(0.5, 0.5, 1), V3(0, 0, -1), 0, 0.5}));
}

TEST_CASE("ray caster: many equal faces need no deep tree; nothing meets nothing; NaN is refused") {
    Soup s;
    s.vertices.resize(3, 3);
    s.vertices << 0, 1, 0, 0, 0, 1, 0, 0, 0;
    s.faces.assign(5000, Face{0, 1, 2});
    const RayCaster equal(s.vertices, s.faces);
    CHECK(equal.nearest(Ray{V3(0.2, 0.2, 1), V3(0, 0, -1)}).t == 1.0);
    const RayCaster empty(Columns<double>(3, 0), {});
    CHECK_FALSE(empty.nearest(Ray{V3(0, 0, 0), V3(0, 0, 1)}));
    CHECK_FALSE(empty.nearest(RayBundle{V3(0, 0, 0), {}})[0]);
    s.vertices(1, 1) = std::nan("");
    CHECK_THROWS_AS(RayCaster(s.vertices, s.faces), Error);
}
