// SPDX-License-Identifier: Apache-2.0
#include <rye/rig/eyeball.hpp>

#include <doctest/doctest.h>

#include <map>

#include <rye/math/rotation.hpp>

using namespace rye;

namespace {

template <class T>
double volume(const EyeballTemplate<T>& eye) {
    double v = 0;
    for (const auto& f : eye.faces) {
        const Vec3<double> a = eye.points.col(f[0]).template cast<double>();
        const Vec3<double> b = eye.points.col(f[1]).template cast<double>();
        const Vec3<double> c = eye.points.col(f[2]).template cast<double>();
        v += dot(a, cross(b, c)) / 6;
    }
    return v;
}

EyeballShape coarse() {
    EyeballShape s;
    s.iris_rings = 5, s.sclera_rings = 3, s.back_rings = 2;
    return s;
}

} // namespace

TEST_CASE("eyeball: a closed surface with normals outward, at every density") {
    EyeballShape least;
    least.iris_rings = 2, least.sclera_rings = 1, least.back_rings = 1;
    const EyeballShape whole;
    for (const EyeballShape& shape :
         {whole, coarse(), least, whole.with_flat_iris(), whole.with_radius(12.0)}) {
        const EyeballTemplate<double> eye = eyeball_template<double>(shape);
        const auto points = static_cast<std::size_t>(eye.points.cols());
        std::map<std::array<Index, 2>, int> directed;
        for (const auto& f : eye.faces)
            for (std::size_t k = 0; k < 3; ++k) ++directed[{f[k], f[(k + 1) % 3]}];
        for (const auto& [edge, count] : directed) {
            REQUIRE(count == 1);
            REQUIRE(directed.count({edge[1], edge[0]}) == 1);
        }
        CHECK(points - directed.size() / 2 + eye.faces.size() == 2);  // Euler: a sphere
        CHECK(eye.labels.size() == points);
        for (const auto& f : eye.faces) {
            const Vec3<double> a = eye.points.col(f[0]), b = eye.points.col(f[1]);
            const Vec3<double> c = eye.points.col(f[2]);
            REQUIRE(dot(a, cross(b, c)) > 0);
        }
    }
}

TEST_CASE("eyeball: the default has the size and the sampling of an eye") {
    const EyeballTemplate<float> eye = eyeball_template<float>({});
    CHECK(eye.points.cols() >= 1500);
    CHECK(eye.points.cols() <= 2500);
    const double sphere = 4.18879 * 0.12 * 0.12 * 0.12;
    CHECK(volume(eye) > 0.98 * sphere);
    CHECK(volume(eye) < 1.04 * sphere);
    CHECK(eye.points.row(2).maxCoeff() == doctest::Approx(0.056 + 0.078));  // apex of the cornea
    CHECK(eye.points.row(2).minCoeff() == doctest::Approx(-0.12));
    double iris = 0, back = 0, least = 1, greatest = 0;
    Index inside = 0;
    for (Index i = 0; i < eye.points.cols(); ++i) {
        const double s = double(eye.spacing(0, i));
        const EyeLabel label = eye.labels[static_cast<std::size_t>(i)];
        if (label == EyeLabel::back) back = std::max(back, s);
        if (label != EyeLabel::pupil && label != EyeLabel::iris) continue;
        ++inside;
        iris = std::max(iris, s);
        least = std::min(least, s), greatest = std::max(greatest, s);
    }
    CHECK(inside > 600);
    CHECK(greatest < 2.5 * least);  // uniform density in the iris
    CHECK(back > 3 * iris);
}

TEST_CASE("eyeball: labels follow the radii, front to back") {
    const EyeballShape shape;
    const EyeballTemplate<double> eye = eyeball_template<double>(shape);
    for (Index i = 0; i < eye.points.cols(); ++i) {
        const double r = eye.points.col(i).head<2>().norm(), z = eye.points(2, i);
        switch (eye.labels[static_cast<std::size_t>(i)]) {
            case EyeLabel::pupil: CHECK((r <= shape.pupil_radius + 1e-12 && z > 0)); break;
            case EyeLabel::iris:
                CHECK((r > shape.pupil_radius && r <= shape.limbus_radius + 1e-12 && z > 0));
                break;
            case EyeLabel::sclera: CHECK((r > shape.limbus_radius && z >= 0)); break;
            case EyeLabel::back: CHECK(z < 0); break;
        }
        // Every point is on the sphere or on the cornea, and inside neither.
        const double sphere = eye.points.col(i).norm() - shape.sclera_radius;
        const Vec3<double> offset(0, 0, shape.cornea_offset);
        const Vec3<double> from_cornea = eye.points.col(i) - offset;
        const double cornea = from_cornea.norm() - shape.cornea_radius;
        CHECK(std::max(sphere, -1.) >= -1e-12);
        CHECK(std::min(std::abs(sphere), std::abs(cornea)) <= 1e-12);
    }
}

TEST_CASE("eyeball: gaze from the mesh, at rest and turned anywhere") {
    const EyeballShape shape;
    const EyeballTemplate<double> eye = eyeball_template<double>(shape);
    for (const Index i : eye.iris8)
        CHECK(eye.points.col(i).head<2>().norm() == doctest::Approx(shape.limbus_radius));
    Vec3<double> centre = Vec3<double>::Zero();
    for (const Index i : eye.equator) centre += eye.points.col(i);
    CHECK(centre.norm() <= 1e-13);
    CHECK((gaze_from_mesh(eye, eye.points) - Vec3<double>(0, 0, 1)).norm() <= 1e-14);
    const Mat3<double> r = so3_exp(Vec3<double>(0.4, -0.7, 0.1));
    const Columns<double> moved = (1.7 * r * eye.points).colwise() + Vec3<double>(3, -2, 1);
    CHECK((gaze_from_mesh(eye, moved) - r.col(2)).norm() <= 1e-13);
}

TEST_CASE("eyeball: a flat iris is a disc at its plane, the rest unchanged") {
    const EyeballShape bulge, flat = bulge.with_flat_iris();
    const EyeballTemplate<double> a = eyeball_template<double>(bulge);
    const EyeballTemplate<double> b = eyeball_template<double>(flat);
    REQUIRE(a.points.cols() == b.points.cols());
    for (Index i = 0; i < a.points.cols(); ++i) {
        const double r = a.points.col(i).head<2>().norm();
        const bool iris = r <= bulge.limbus_radius + 1e-12 && a.points(2, i) > 0;
        CHECK(a.points.col(i).head<2>() == b.points.col(i).head<2>());
        CHECK(b.points(2, i) == doctest::Approx(iris ? *flat.iris_plane : a.points(2, i)));
    }
}

TEST_CASE("eyeball: the iris curves from its middle to the limbus, which lies on the sphere") {
    EyeballShape shape = EyeballShape{}.with_radius(0.158).with_limbus(0.063);
    const double rim = std::sqrt(0.158 * 0.158 - 0.063 * 0.063);
    CHECK(shape.limbus_plane() == doctest::Approx(rim).epsilon(1e-12));
    CHECK(shape.front(0) > 0.158); // the bulge
    CHECK(shape.pupil_radius / shape.limbus_radius == doctest::Approx(0.020 / 0.059));
    shape.iris_plane = 0.1573;
    const EyeballTemplate<double> eye = eyeball_template<double>(shape);
    for (Index i = 0; i < eye.points.cols(); ++i) {
        const double r = eye.points.col(i).head<2>().norm();
        if (eye.labels[static_cast<std::size_t>(i)] == EyeLabel::sclera)
            CHECK(eye.points.col(i).norm() == doctest::Approx(0.158));
        if (eye.labels[static_cast<std::size_t>(i)] != EyeLabel::iris) continue;
        const double share = r / 0.063;
        CHECK(eye.points(2, i) ==
              doctest::Approx((1 - share * share) * 0.1573 + share * share * rim));
    }
}

TEST_CASE("eyeball: normals are unit and outward, the sphere's where it is one") {
    const EyeballTemplate<double> eye = eyeball_template<double>(EyeballShape{}.with_flat_iris());
    for (Index i = 0; i < eye.points.cols(); ++i) {
        const Vec3<double> n = eye.normals.col(i), p = eye.points.col(i);
        CHECK(n.norm() == doctest::Approx(1));
        CHECK(n.dot(p) > 0);
        if (eye.labels[static_cast<std::size_t>(i)] == EyeLabel::back)
            CHECK(n.dot(p.normalized()) > 0.99);
        if (eye.labels[static_cast<std::size_t>(i)] == EyeLabel::pupil) CHECK(n.z() > 1 - 1e-12);
    }
}

TEST_CASE("eyeball: a larger eye is the same eye") {
    const EyeballTemplate<double> a = eyeball_template<double>({});
    const EyeballTemplate<double> b = eyeball_template<double>(EyeballShape{}.with_radius(0.24));
    CHECK((b.points - 2 * a.points).cwiseAbs().maxCoeff() <= 1e-15);
    CHECK((b.spacing - 2 * a.spacing).cwiseAbs().maxCoeff() <= 1e-15);
}

TEST_CASE("eyeball: shapes that are no eye are refused") {
    const auto refused = [](auto change) {
        EyeballShape s;
        change(s);
        CHECK_THROWS_AS(eyeball_template<float>(s), Error);
    };
    refused([](EyeballShape& s) { s.sclera_radius = 0; });
    refused([](EyeballShape& s) { s.sclera_radius = std::nan(""); });
    refused([](EyeballShape& s) { s.pupil_radius = 0.06; });
    refused([](EyeballShape& s) { s.limbus_radius = 0.08; });
    refused([](EyeballShape& s) { s.cornea_offset = -1; });
    refused([](EyeballShape& s) { s.iris_rings = 1; });
    refused([](EyeballShape& s) { s.back_rings = 100000; });
    refused([](EyeballShape& s) { s.iris_plane = 0.5; });
    refused([](EyeballShape& s) { s.iris_plane = -0.1; });
}
