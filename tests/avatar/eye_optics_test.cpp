// SPDX-License-Identifier: Apache-2.0
#include <rye/avatar/eye_optics.hpp>

#include <algorithm>
#include <vector>

#include <doctest/doctest.h>

#include "../support/avatar_law.hpp"

using namespace rye;
using namespace rye::test;

namespace {

template <EffectSet E>
std::vector<std::string> tensors() {
    std::vector<std::string> names;
    const auto note = [&](const std::string& name, const auto&) { names.push_back(name); };
    const TwoStream<double, E> avatar = restricted<E>(avatar_of_optics());
    TwoStream<double, E>::fields(note, avatar);
    TwoStream<double, E>::buffers(note, avatar);
    return names;
}

template <EffectSet E>
bool has_tensor(const std::string& name) {
    const std::vector<std::string> all = tensors<E>();
    return std::find(all.begin(), all.end(), name) != all.end();
}

static_assert(std::is_empty_v<EyeOptics<float>>);
static_assert(std::is_empty_v<Drivers<float, Effects<>>>);
static_assert(sizeof(Drivers<float, Effects<Glint>>) == sizeof(Vec3<float>));
static_assert(sizeof(EyeStream<float, Effects<CornealRefraction>>) ==
              sizeof(EyeStream<float, Effects<>>) + 2 * sizeof(Columns<float>));

} // namespace

TEST_CASE("an avatar's vjp is the transpose of its duals with refraction and glint") {
    CHECK(law_error<OpticsEffects>(1) <= 1e-11);
}

TEST_CASE("refraction and glint have their tensors, and only where they are on") {
    CHECK(has_tensor<OpticsEffects>("eyes.light_position"));
    CHECK(has_tensor<OpticsEffects>("eyes.refractive_index"));
    CHECK(has_tensor<Effects<Glint>>("eyes.cornea"));
    CHECK_FALSE(has_tensor<Effects<Glint>>("eyes.refractive_index"));
    CHECK_FALSE(has_tensor<Effects<CornealRefraction>>("eyes.light_intensity"));
    CHECK(has_tensor<Effects<CornealRefraction>>("eyes.cornea"));
    for (const std::string& name : tensors<AllEffects>()) {
        CHECK(name.find("cornea") == std::string::npos);
        CHECK(name.find("light") == std::string::npos);
        CHECK(name.find("refractive") == std::string::npos);
    }
}

TEST_CASE("without an index corneas refract nothing, ask for no camera and have no tensor") {
    using E = More<AllEffects, CornealRefraction>;
    TwoStream<double, E> avatar = avatar_with_parts<E>();
    const Drivers<double, E> seen = seen_drivers<E>(tiny_drivers<double>());
    const TwoStreamTrace<double, E> refracted = driven(avatar, seen);
    avatar.eyes.optics.index = {};
    Drivers<double, E> drivers = restricted<E>(drivers_of_all());
    CHECK(!drivers.camera.allFinite());
    const TwoStreamTrace<double, E> plain = driven(avatar, drivers);
    const auto rest = driven(restricted<AllEffects>(avatar), restricted<AllEffects>(drivers));
    Gaussians<double>::fields(
        [](const std::string& name, const auto& a, const auto& b) { CHECK_MESSAGE(a == b, name); },
        plain.gaussians, rest.gaussians);
    CHECK(!(plain.gaussians.mean == refracted.gaussians.mean));
    const auto none = [](const std::string& name, const auto&) {
        CHECK_MESSAGE(name.find("eyes.cornea") == std::string::npos, name);
        CHECK_MESSAGE(name.find("refractive") == std::string::npos, name);
    };
    TwoStream<double, E>::fields(none, avatar);
    TwoStream<double, E>::buffers(none, avatar);
    CHECK(law_error<E>(avatar, drivers, 3) <= 1e-11);
    avatar.eyes.optics.index = Columns<double>::Constant(1, 3, 1.3);
    CHECK_THROWS_WITH_AS(driven(avatar, seen),
                         doctest::Contains("got refractive indices of 1 x 3, expected 1 x 2"),
                         Error);
}

TEST_CASE("a camera is asked for, and corneas") {
    auto avatar = avatar_of_optics();
    auto drivers = drivers_of_optics();
    CHECK_NOTHROW(driven(avatar, drivers));
    CHECK_THROWS_WITH_AS(driven(avatar, restricted<OpticsEffects>(drivers_of_all())),
                         doctest::Contains("camera"), Error);
    avatar.eyes.optics.cornea.resize(0, 0);
    CHECK_THROWS_WITH_AS(driven(avatar, drivers), doctest::Contains("set_corneas"), Error);
}

TEST_CASE("an iris in the world is where the refracted ray of the camera meets it") {
    // By an independent trace in the world: the camera's ray to where the Gaussian is seen, bent at
    // the cornea as it stands in the world, must pass the Gaussian's place without refraction.
    using E = Effects<HeadPose, LeftGaze, RightGaze, CornealRefraction>;
    TwoStream<double, E> avatar = restricted<E>(avatar_of_optics());
    const EyeballShape shape = EyeballShape{.iris_plane = 0.1};
    const Cornea<double> cornea = cornea_of<double>(shape);
    set_corneas(avatar.eyes.optics, cornea, cornea);
    set_refraction(avatar.eyes.optics);
    const Index n = avatar.eyes.points_of(0), all = avatar.eyes.position.cols();
    for (Index i = 0; i < all; ++i) {
        const double r = 0.05 * double(i % n) / double(n), a = 1.3 * double(i);
        avatar.eyes.position.col(i) << r * std::cos(a), r * std::sin(a), shape.iris(r);
    }
    const Drivers<double, E> drivers = restricted<E>(drivers_of_optics());
    const auto with = driven(avatar, drivers);
    using Rest = Less<E, CornealRefraction>;
    const auto without = driven(restricted<Rest>(avatar), restricted<Rest>(drivers));
    double worst = 0, moved = 0;
    for (Index i = 0; i < all; ++i) {
        const EyeTransform<double>& eye = with.eyes.optics.placed[i < n ? 0 : 1];
        const Vec3<double> centre = eye.apply(cornea.centre);
        const double radius = eye.scale * cornea.radius;
        const Index at = with.face_count + i;
        const Vec3<double> seen = with.gaussians.mean.col(at), is = without.gaussians.mean.col(at);
        const Vec3<double> d = (seen - drivers.camera).normalized(), to = centre - drivers.camera;
        const double along = d.dot(to);
        const double off = radius * radius - (to - along * d).squaredNorm();
        REQUIRE(off > 0);
        const Vec3<double> q = drivers.camera + (along - std::sqrt(off)) * d;
        const Vec3<double> normal = (q - centre) / radius;
        const double c = -d.dot(normal);
        const Vec3<double> across = (d + c * normal) / detail::aqueous_index;
        const Vec3<double> r = across - std::sqrt(1 - across.squaredNorm()) * normal;
        worst = std::max(worst, cross(Vec3<double>(is - q), r).norm());
        moved = std::max(moved, (seen - is).norm());
    }
    CHECK(worst < 1e-12);
    CHECK(moved > 1e-3);
}

TEST_CASE("a light that is moved takes its highlight to where a spherical mirror shows it") {
    // By the law of reflection in the world, for a light that each point in turn mirrors.
    using E = Effects<HeadPose, LeftGaze, RightGaze, Glint>;
    TwoStream<double, E> avatar = restricted<E>(avatar_of_optics());
    EyeOptics<double, E>& optics = avatar.eyes.optics;
    const Cornea<double> cornea = cornea_of<double>(EyeballShape{.iris_plane = 0.1});
    set_corneas(optics, cornea, cornea);
    const Index all = avatar.eyes.position.cols();
    for (Index i = 0; i < all; ++i) {
        const double r = 0.03 * double(i) / double(all), a = 1.3 * double(i);
        avatar.eyes.position.col(i) << r * std::cos(a), r * std::sin(a),
            cornea.centre.z() + std::sqrt(cornea.radius * cornea.radius - r * r);
    }
    const Drivers<double, E> drivers = restricted<E>(drivers_of_optics());
    const auto dark = driven(avatar, drivers);
    resize_lights(optics, 1);
    optics.light_intensity << 0.9, 0.3, 0.7;
    optics.light_width << 0.02;
    int there = 0;
    double off = 0;
    for (std::size_t e = 0; e < 2; ++e)
        for (Index k = 0; k < avatar.eyes.points_of(e); ++k) {
            const EyeTransform<double>& eye = dark.eyes.optics.placed[e];
            const Index first = dark.face_count + avatar.eyes.first_point(e);
            const Vec3<double> at = dark.gaussians.mean.col(first + k),
                               normal = (at - eye.apply(cornea.centre)).normalized(),
                               view = (at - drivers.camera).normalized();
            optics.light_position = 1e7 * (view - 2 * view.dot(normal) * normal);
            const Columns<double> added =
                (driven(avatar, drivers).gaussians.feature - dark.gaussians.feature)
                    .block(0, first, 3, avatar.eyes.points_of(e));
            Index brightest = 0;
            added.colwise().sum().maxCoeff(&brightest);
            there += brightest == k ? 1 : 0;
            off = std::max(off, (added.col(k) - optics.light_intensity).cwiseAbs().maxCoeff());
        }
    CHECK(there == all);
    CHECK(off < 1e-6); // the light is far, not infinitely far
}

TEST_CASE("held without refraction and glint it looks the same at that camera") {
    const auto all = avatar_of_optics();
    const auto drivers = drivers_of_optics();
    const auto same = [&]<EffectSet Fewer>(Fewer) {
        const auto a = held<Fewer>(ScalarBackend<>{}, all, tiny_config(), tiny_roles(), drivers);
        Drivers<double, Fewer> d = restricted<Fewer>(drivers);
        const auto x = driven(a, d);
        const auto y = driven(all, drivers);
        double most = 0;
        Gaussians<double>::fields([&](const std::string&, const auto& p, const auto& q) {
            most = std::max(most, (p - q).cwiseAbs().maxCoeff());
        }, copy_of(x.eye_gaussians()), copy_of(y.eye_gaussians()));
        return most;
    };
    CHECK(same(Less<OpticsEffects, Glint>{}) <= 1e-13);
    CHECK(same(Less<OpticsEffects, CornealRefraction, Glint>{}) <= 1e-13);
    CHECK(same(Less<OpticsEffects, LeftGaze>{}) <= 1e-13);  // the cornea turns with its eye
}
