// SPDX-License-Identifier: Apache-2.0
#include <rye/interactive/player.hpp>

#include <limits>
#include <type_traits>
#include <utility>

#include <doctest/doctest.h>

#include <rye/core/thread_pool.hpp>

#include "../support/hostile.hpp"
#include "../support/tiny_playable.hpp"

using namespace rye;
using namespace rye::test;

namespace {

// What outlives no call is not kept.
using Kernels = XsimdBackend<>;
using Player = AvatarPlayer<Kernels>;
using Playable = PlayableAvatar<float>;
static_assert(std::is_constructible_v<Player, Kernels, Playable&> &&
              std::is_constructible_v<Player, Kernels, const Playable&>);
static_assert(!std::is_constructible_v<Player, Kernels, Playable> &&
              !std::is_constructible_v<Player, Kernels, const Playable>);
template <class Cache, class Avatar, class Config, class Roles>
constexpr bool keeps = std::is_constructible_v<Cache, Kernels, Avatar, Config, Roles>;
using Avatar = TwoStream<float>;
template <class Cache>
constexpr bool keeps_lasting_ones =
    keeps<Cache, Avatar&, AvatarConfig&, LandmarkRoles&> &&
    keeps<Cache, const Avatar&, const AvatarConfig&, const LandmarkRoles&> &&
    !keeps<Cache, Avatar, AvatarConfig&, LandmarkRoles&> &&
    !keeps<Cache, const Avatar, AvatarConfig&, LandmarkRoles&> &&
    !keeps<Cache, Avatar&, AvatarConfig, LandmarkRoles&> &&
    !keeps<Cache, Avatar&, AvatarConfig&, LandmarkRoles>;
static_assert(keeps_lasting_ones<DriveCache<Kernels, float>>);
static_assert(keeps_lasting_ones<FrameCache<Kernels, Balanced, float>>);
template <class Pool>
concept GivesThreads = requires(Pool&& pool) { std::forward<Pool>(pool).threads(); };
static_assert(GivesThreads<ThreadPool&> && !GivesThreads<ThreadPool>);

/// The picture by the ordinary functions.
Image<float> whole_picture(const PlayableAvatar<float>& p, const Drivers<float>& drivers,
                           const Pinhole<float>& camera, const VecX<float>& background,
                           double dilation, const std::array<float, 2>& pupil = {1, 1}) {
    const XsimdBackend<> backend;
    TwoStreamTrace<float, TrainedEffects> trace;
    const auto all = with_pupils(seen_from(restricted<TrainedEffects>(drivers), camera), pupil);
    drive(backend, p.avatar, {p.config, p.roles, all}, trace);
    const Pinhole<float> small = render_camera(camera, 1 << p.avatar.upsampler.shape.doublings);
    Rasterizer<FeaturesOnly<Balanced>> rasterizer;
    rasterizer.accuracy.dilation = dilation;
    const Image<float> large = upsampler_forward(
        backend, p.avatar.upsampler,
        rasterizer.forward(backend, trace.gaussians, small, background).feature, nullptr);
    Image<float> out(camera.width, camera.height, 3);
    for (int y = 0; y < camera.height; ++y)
        for (int x = 0; x < camera.width; ++x) out.at(x, y) = large.at(x, y);
    return out;
}

} // namespace

TEST_CASE("player: every picture is that of a whole render, bit for bit, at any size") {
    for (const TinyParts& parts : {TinyParts{}, TinyParts{.visual = true},
                                   TinyParts{.light = true},
                                   TinyParts{.highlights = true}, TinyParts{true, true, true, true}})
        for (const int doublings : {0, 1}) {
            const PlayableAvatar<float> p = tiny_playable(parts, doublings);
            AvatarPlayer<XsimdBackend<>> player(XsimdBackend<>(), p);
            Drivers<float> drivers = p.neutral;
            Pinhole<float> camera = p.camera;
            VecX<float> background = p.background;
            const auto check = [&] {
                const Image<float>& picture = player.draw(drivers, camera, background);
                CHECK(picture.width == camera.width);
                CHECK(picture.height == camera.height);
                CHECK(picture.pixels ==
                      whole_picture(p, drivers, camera, background, player.dilation()).pixels);
            };
            check();
            CHECK(player.dilation() == 0.3);
            CHECK(player.work().gaussians == 78);
            drivers.gaze[0] = gaze_vector<float>(0.1F, -0.2F);
            check();
            CHECK(player.work().gaussians > 0);
            CHECK(player.work().gaussians < 78);
            CHECK(player.work().networks == (parts.driven_eyes ? 3 : 2));
            check();
            CHECK(player.work().gaussians == 0);
            CHECK(player.work().pixels == 0);
            drivers.pose[1] += 0.3F;
            check();
            drivers.expression[1] += 0.5F;
            check();
            camera.width = 61;
            camera.height = 64;
            check();
            background[0] = 0;
            check();
            camera = scaled(camera, 1.5);
            check();
            // Moved without a picture, there and back: Gaussians as of a picture, and a whole one next.
            const Columns<float> mean = player.gaussians().mean;
            const Drivers<float> before = drivers;
            drivers.gaze[1] = gaze_vector<float>(-0.2F, 0.1F);
            CHECK(player.drive(drivers, camera).mean.cols() == 78);
            CHECK(player.work().gaussians > 0);
            CHECK(player.work().tiles == 0);
            CHECK(player.drive(before, camera).mean == mean);
            check();
            player.drive(before, camera);
            check();
        }
}

TEST_CASE("player: other pupils move the eyes alone, and stay until they are set again") {
    const PlayableAvatar<float> p =
        tiny_playable(TinyParts{.driven_eyes = true, .highlights = true, .irises = true});
    AvatarPlayer<XsimdBackend<>> player(XsimdBackend<>(), p);
    Drivers<float> drivers = p.neutral;
    const auto check = [&](const std::array<float, 2>& pupil) {
        const Image<float> picture = player.draw(drivers, p.camera, p.background);
        CHECK(picture.pixels ==
              whole_picture(p, drivers, p.camera, p.background, player.dilation(), pupil).pixels);
        return picture;
    };
    const Image<float> rest = check({1, 1});
    player.set_pupils({1.6F, 0.7F});
    CHECK(check({1.6F, 0.7F}).pixels != rest.pixels);
    CHECK(player.work().networks == 0);
    CHECK(player.work().gaussians == 18);
    drivers.gaze[0] = gaze_vector<float>(0.1F, -0.2F);
    check({1.6F, 0.7F});
    CHECK_FAULT(player.set_pupils({1, 2.5F}), "pupil: got the ratio 2.5 for the right eye");
    check({1.6F, 0.7F});
    CHECK(player.work().gaussians == 0);
}

TEST_CASE("player: Gaussians are as wide on the head in pictures of other sizes") {
    const PlayableAvatar<float> p = tiny_playable({}, 0);
    AvatarPlayer<XsimdBackend<>> player(XsimdBackend<>(), p);
    const auto dilation = [&](const Drivers<float>& drivers, const Pinhole<float>& camera) {
        player.draw(drivers, camera, p.background);
        return player.dilation();
    };
    const Image<float> trained = player.draw(p.neutral, p.camera, p.background);
    CHECK(player.dilation() == 0.3);
    CHECK(dilation(p.neutral, scaled(p.camera, 2)) == doctest::Approx(1.2));
    const Pinhole<float> half = scaled(p.camera, 0.5); // of whole pixels
    const float share = half.fx / p.camera.fx * (half.fy / p.camera.fy);
    CHECK(dilation(p.neutral, half) == doctest::Approx(0.3F * share));
    CHECK(share < 0.3F);
    CHECK(dilation(p.neutral, scaled(p.camera, 1. / 16)) == 0.02);
    // A camera that is half as far from the head's middle, and a head that is half as far.
    const Columns<float>& points = p.avatar.face.position;
    const HeadTransform<float> head = head_transform(p.neutral);
    const Vec3<float> middle =
        head.scale * (head.rotation * box_middle(points)) + head.translation;
    const Vec3<float> at = p.camera.camera_from_world.apply(middle);
    Pinhole<float> near = p.camera;
    near.camera_from_world.translation[2] -= at[2] / 2;
    CHECK(dilation(p.neutral, near) == doctest::Approx(1.2));
    Drivers<float> moved = p.neutral;
    moved.pose.tail<3>() -= p.camera.camera_from_world.turn_back(Vec3<float>(0, 0, at[2] / 2));
    CHECK(dilation(moved, p.camera) == doctest::Approx(1.2));
    moved = p.neutral;
    moved.pose.tail<3>() -= p.camera.camera_from_world.turn_back(Vec3<float>(0, 0, 2 * at[2]));
    CHECK(std::isfinite(dilation(moved, p.camera))); // behind the camera

    // Half of a picture that is twice as large is the trained one but for the pixels' own width.
    const Pinhole<float> large = scaled(p.camera, 2);
    const auto beside = [&](double d) {
        const Image<float> drawn = whole_picture(p, p.neutral, large, p.background, d);
        double sum = 0;
        for (int y = 0; y < trained.height; ++y)
            for (int x = 0; x < trained.width; ++x) {
                const VecX<float> mean = 0.25F * (drawn.at(2 * x, 2 * y) + drawn.at(2 * x + 1, 2 * y) +
                                           drawn.at(2 * x, 2 * y + 1) +
                                           drawn.at(2 * x + 1, 2 * y + 1));
                sum += static_cast<double>((mean - trained.at(x, y)).squaredNorm());
            }
        return std::sqrt(sum);
    };
    CHECK(beside(1.2) < beside(0.3) / 2);
}

TEST_CASE(
    "player: drivers, cameras and backgrounds that do not suit are refused, and the next is "
    "drawn") {
    const PlayableAvatar<float> p = tiny_playable();
    AvatarPlayer<XsimdBackend<>> player(XsimdBackend<>(), p);
    const Image<float> right = player.draw(p.neutral, p.camera, p.background);
    const float nan = std::numeric_limits<float>::quiet_NaN();
    Drivers<float> d = p.neutral;
    d.expression.resize(4);
    CHECK_FAULT(player.draw(d, p.camera, p.background), "got 4 coefficients, expected 3");
    d = p.neutral;
    d.pose[2] = nan;
    CHECK_FAULT(player.draw(d, p.camera, p.background), "'pose': value 2 is nan");
    d = p.neutral;
    d.gaze[1].setZero();
    CHECK_FAULT(player.draw(d, p.camera, p.background), "the right eye's has the length 0,");
    Pinhole<float> c = p.camera;
    c.near_depth = 0;
    CHECK_FAULT(player.draw(p.neutral, c, p.background), "'near_depth' is 0,");
    CHECK_FAULT(player.draw(p.neutral, p.camera, VecX<float>::Zero(3)),
                "'background': got 3 channels, expected 5");
    d = p.neutral;
    d.expression.setConstant(std::numeric_limits<float>::max());
    CHECK_FAULT(player.draw(d, p.camera, p.background), "is not finite; the drivers are far");
    CHECK_FAULT(player.drive(d, p.camera), "is not finite; the drivers are far");
    CHECK(player.draw(p.neutral, p.camera, p.background).pixels == right.pixels);
}
