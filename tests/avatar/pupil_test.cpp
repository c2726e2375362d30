// SPDX-License-Identifier: Apache-2.0
// Avatars whose pupils a frame drives.
#include <rye/avatar/trained.hpp>

#include <doctest/doctest.h>

#include "../support/avatar_law.hpp"
#include "../support/hostile.hpp"
#include "../support/neutral_law.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using Eyes = Effects<HeadPose, LeftGaze, RightGaze, Kappa, EyeOffset, CornealRefraction, Glint,
                     Pupil>;
using OneEye = Effects<RightGaze, Pupil>;

template <EffectSet E>
Drivers<double, E> drivers_with_pupils() {
    return with_pupils(seen_drivers<E>(tiny_drivers<double>()), {0.6, 1.5});
}

static_assert(std::is_empty_v<detail::Slot<Effects<LeftGaze>, Pupil, int>>);
static_assert(sizeof(Drivers<float, OneEye>) == sizeof(Drivers<float, Effects<RightGaze>>) +
                                                    sizeof(float));
static_assert(sizeof(EyeStream<float, OneEye>) == sizeof(EyeStream<float, Effects<RightGaze>>));

} // namespace

TEST_CASE("pupils: the vjp of an avatar is the transpose of its duals") {
    CHECK(law_error<Eyes>(avatar_with_parts<Eyes>(), drivers_with_pupils<Eyes>(), 2) <= 1e-11);
    CHECK(law_error<OneEye>(avatar_with_parts<OneEye>(), drivers_with_pupils<OneEye>(), 3) <=
          1e-11);
}

TEST_CASE("pupils: Gaussians are where the moved points are, and stretched along the surface") {
    TwoStream<double, OneEye> avatar = avatar_with_parts<OneEye>();
    Drivers<double, OneEye> drivers = drivers_with_pupils<OneEye>();
    const Gaussians<double> wide = driven(avatar, drivers).gaussians;
    make_neutral<Pupil>(avatar, drivers);
    const Gaussians<double> rest = driven(avatar, drivers).gaussians;
    const EyeStream<double, OneEye>& eyes = avatar.eyes;
    const Index face = avatar.face.position.cols(), left = eyes.points_of(0);
    EyeTransform<double> placed = detail::eye_at<double>(eyes.centre.col(1));
    turn_eye<double>(placed, of_eye<1>(drivers.gaze));
    const PupilMap<double> map{iris_of(eyes, 1), 1.5};
    Index moved = 0;
    for (Index i = 0; i < eyes.position.cols(); ++i) {
        const Vec3<double> point = eyes.position.col(i);
        const bool own = i >= left;
        const Vec3<double> still = rest.mean.col(face + i),
                           at = own ? placed.apply(map(point)) : still;
        const double by = own ? map.stretch(point) : 1;
        CHECK((wide.mean.col(face + i) - at).norm() < 1e-14);
        CHECK((wide.scale.col(face + i) -
               rest.scale.col(face + i).cwiseProduct(Vec3<double>(by, by, 1))).norm() < 1e-14);
        moved += by != 1;
    }
    CHECK(moved > 4);
    CHECK(wide.rotation == rest.rotation);
    CHECK(wide.feature == rest.feature);
}

TEST_CASE("pupils: at rest an avatar equals the one without the effect, to the bit") {
    const auto check = [&]<class T>(T) {
        TwoStream<T, Eyes> avatar = lifted<T>(avatar_with_parts<Eyes>());
        using Rest = Less<Eyes, Pupil>;
        Drivers<T, Eyes> drivers = drivers_with_pupils<Eyes>().template cast<T>();
        const auto apart = [&] {
            return ulps(driven(avatar, drivers).gaussians,
                        driven(restricted<Rest>(avatar), restricted<Rest>(drivers)).gaussians);
        };
        CHECK(apart() > 1000);
        make_neutral<Pupil>(avatar, drivers);
        CHECK(apart() == 0);
    };
    check(double());
    check(float());
    const Drivers<float, OneEye> neutral = neutral_drivers<float, OneEye>(tiny_config());
    CHECK(of_eye<1>(neutral.pupil) == 1);
}

TEST_CASE("pupils: an avatar that leaves them out looks as it did at the frame it is held at") {
    using From = Less<Eyes, CornealRefraction>;
    const TwoStream<double, From> all = avatar_with_parts<From>();
    const Drivers<double, From> at = drivers_with_pupils<From>();
    const Gaussians<double> seen = driven(all, at).gaussians;
    const auto apart = [&]<EffectSet Fewer>(Fewer) {
        const auto fewer =
            held<Fewer>(ScalarBackend<>{}, all, tiny_config(), tiny_roles(), at);
        const Gaussians<double> g = driven(fewer, restricted<Fewer>(at)).gaussians;
        double most = 0;
        Gaussians<double>::fields([&](const std::string&, const auto& a, const auto& b) {
            most = std::max(most, (a - b).cwiseAbs().maxCoeff());
        }, g, seen);
        return most;
    };
    CHECK(apart(Less<From, Pupil>{}) < 1e-13);
    CHECK(apart(Effects<HeadPose, Glint>{}) < 1e-13);
    CHECK(apart(Less<From, Pupil, Glint>{}) < 1e-13);
}

TEST_CASE("pupils: what drives an avatar refuses a ratio that no pupil has") {
    TwoStream<float, OneEye> avatar = lifted<float>(avatar_with_parts<OneEye>());
    Drivers<float, OneEye> drivers = drivers_with_pupils<OneEye>().cast<float>();
    of_eye<1>(drivers.pupil) = -1;
    CHECK_FAULT(driven(avatar, drivers),
                "pupil: got the ratio -1 for the right eye, expected 0.4 to 2, 1 at rest");
}
