// SPDX-License-Identifier: Apache-2.0
/// tests/c/c_test.cpp: what the C interface draws is what the headers draw, and every wrong
/// argument is a code with a message. The calls of client.c are made by a C compiler.
#include <rye/c/rye.h>

#include <cmath>
#include <cstring>
#include <filesystem>
#include <limits>
#include <string>
#include <thread>

#include <doctest/doctest.h>

#include <rye/avatar/gaze_at.hpp>
#include <rye/avatar/idle_head.hpp>
#include <rye/io/avatar_file.hpp>
#include <rye/interactive/player.hpp>
#include <rye/splat/lanes.hpp>

#include "../support/hostile.hpp"
#include "../support/limited.hpp"
#include "../support/random.hpp"
#include "../support/tiny_playable.hpp"

extern "C" int c_client(const rye_cloud* cloud, const rye_camera* camera, float* pixels);

using namespace rye;
using namespace rye::test;

namespace {

struct CloudScene {
    Gaussians<float> g;
    Pinhole<float> camera = look_at<float>({0, 0, 4}, {0, 0, 0}, {0, 1, 0}, 0.5F, {48, 40});
    VecX<float> background = VecX<float>::Constant(5, 0.25F);

    explicit CloudScene(Index count = 200) : g(count, 5) {
        g.mean = 0.5F * random_columns<float>(3, count, 1);
        g.rotation = random_columns<float>(4, count, 2);
        g.scale = (0.05F * random_columns<float>(3, count, 3)).array() + 0.1F;
        g.opacity = (0.4F * random_columns<float>(1, count, 4)).array() + 0.5F;
        g.feature = random_columns<float>(5, count, 5);
    }
    rye_cloud cloud() const {
        rye_cloud c = RYE_INIT(rye_cloud);
        c.channels = 5;
        c.count = g.count();
        c.mean = g.mean.data();
        c.rotation = g.rotation.data();
        c.scale = g.scale.data();
        c.opacity = g.opacity.data();
        c.feature = g.feature.data();
        return c;
    }
    rye_camera c_camera() const {
        rye_look look = RYE_INIT(rye_look);
        look.eye[2] = 4;
        look.up[1] = 1;
        look.vertical_fov = 0.5F;
        look.width = 48;
        look.height = 40;
        rye_camera c = RYE_INIT(rye_camera);
        REQUIRE(rye_camera_look_at(&look, &c) == RYE_OK);
        return c;
    }
};

struct WithDepth : Balanced {
    static constexpr Outputs outputs = {.depth = true};
};

void check_close(const Columns<float>& a, const Columns<float>& b) {
    REQUIRE(a.rows() == b.rows());
    REQUIRE(a.cols() == b.cols());
    const float size = b.cwiseAbs().maxCoeff();
    CHECK(size > 0);
    CHECK((a - b).cwiseAbs().maxCoeff() <= 2e-6F * size);
}

/// Whether the last failure has this code and a message with these words.
void check_failed(rye_status got, rye_status status, const std::string& words) {
    CHECK(got == status);
    INFO(std::string(rye_message()));
    CHECK(std::string(rye_message()).find(words) != std::string::npos);
}

rye_renderer* renderer_of(int threads) {
    rye_options options = RYE_INIT(rye_options);
    options.threads = threads;
    rye_renderer* r = nullptr;
    REQUIRE(rye_renderer_create(&options, &r) == RYE_OK);
    return r;
}

} // namespace

TEST_CASE(
    "C interface: image and gradient of a cloud are those of the headers, whatever the threads") {
    const CloudScene s;
    const rye_cloud cloud = s.cloud();
    const rye_camera camera = s.c_camera();
    const XsimdBackend backend;
    const Rasterizer<WithDepth> rasterizer;
    const auto raster = rasterizer.forward(backend, s.g, s.camera, s.background);
    const Columns<float> g_feature = random_columns<float>(5, 48 * 40, 7),
                         g_alpha = random_columns<float>(1, 48 * 40, 8),
                         g_depth = random_columns<float>(1, 48 * 40, 9);
    const auto gradient =
        rasterizer.vjp(backend, s.g, s.camera, s.background, raster, g_feature, &g_alpha, &g_depth);
    for (const int threads : {1, 3}) {
        rye_renderer* renderer = renderer_of(threads);
        Columns<float> feature(5, 48 * 40), alpha(1, 48 * 40), depth(1, 48 * 40);
        rye_image image = RYE_INIT(rye_image);
        image.feature = feature.data();
        image.alpha = alpha.data();
        image.depth = depth.data();
        REQUIRE(rye_draw(renderer, &cloud, &camera, s.background.data(), &image) == RYE_OK);
        CHECK(image.skipped == 0);
        check_close(feature, raster.feature.pixels);
        check_close(alpha, raster.alpha.pixels);
        check_close(depth, raster.depth.pixels);

        rye_image_gradient g_image = RYE_INIT(rye_image_gradient);
        g_image.feature = g_feature.data();
        g_image.alpha = g_alpha.data();
        g_image.depth = g_depth.data();
        Gaussians<float> out(s.g.count(), 5);
        rye_cloud_gradient g_cloud = RYE_INIT(rye_cloud_gradient);
        g_cloud.mean = out.mean.data();
        g_cloud.rotation = out.rotation.data();
        g_cloud.scale = out.scale.data();
        g_cloud.opacity = out.opacity.data();
        g_cloud.feature = out.feature.data();
        REQUIRE(rye_draw_gradient(renderer, &cloud, &g_image, &g_cloud) == RYE_OK);
        Gaussians<float>::fields(
            [](const std::string& name, const auto& a, const auto& b) {
                INFO(name);
                check_close(a, b);
            },
            out, gradient);
        rye_renderer_destroy(renderer);
    }
}

TEST_CASE("C interface: a C11 program draws the same image, and what is null is not written") {
    const CloudScene s;
    const rye_cloud cloud = s.cloud();
    const rye_camera camera = s.c_camera();
    Columns<float> feature(5, 48 * 40);
    CHECK(c_client(&cloud, &camera, feature.data()) == 0);
    const auto raster = Rasterizer<WithDepth>().forward(XsimdBackend{}, s.g, s.camera,
                                                        VecX<float>(VecX<float>::Zero(5)));
    check_close(feature, raster.feature.pixels);
}

TEST_CASE("C interface: wrong arguments are refused by name and value, and nothing is written") {
    const CloudScene s;
    rye_cloud cloud = s.cloud();
    const rye_camera camera = s.c_camera();
    rye_renderer* renderer = renderer_of(1);
    Columns<float> feature = Columns<float>::Constant(5, 48 * 40, -7);
    rye_image image = RYE_INIT(rye_image);
    image.feature = feature.data();
    rye_image_gradient g_image = RYE_INIT(rye_image_gradient);
    rye_cloud_gradient g_cloud = RYE_INIT(rye_cloud_gradient);
    const float* behind = s.background.data();
    const auto draw = [&](const rye_cloud& c, const rye_camera& k) {
        return rye_draw(renderer, &c, &k, behind, &image);
    };
    check_failed(rye_draw_gradient(renderer, &cloud, &g_image, &g_cloud), RYE_ERROR_STATE,
                 "rye_draw has not drawn");
    check_failed(rye_draw(nullptr, &cloud, &camera, behind, &image), RYE_ERROR_ARGUMENT,
                 "renderer: got a null pointer");
    check_failed(rye_draw(renderer, &cloud, &camera, nullptr, &image), RYE_ERROR_ARGUMENT,
                 "background: got a null pointer");
    check_failed(rye_draw(renderer, nullptr, &camera, behind, &image), RYE_ERROR_ARGUMENT,
                 "cloud: got a null pointer");
    rye_cloud c = cloud;
    c.struct_size = 8;
    check_failed(draw(c, camera), RYE_ERROR_VERSION, "cloud: got struct_size 8, expected");
    c = cloud;
    c.channels = 0;
    check_failed(draw(c, camera), RYE_ERROR_ARGUMENT, "cloud: channels: got 0, expected 1 to 1024");
    c = cloud;
    c.count = -1;
    check_failed(draw(c, camera), RYE_ERROR_ARGUMENT, "cloud: count: got -1");
    c.count = std::numeric_limits<std::int64_t>::max();
    check_failed(draw(c, camera), RYE_ERROR_ARGUMENT, "cloud: count: got 9223372036854775807");
    c = cloud;
    c.scale = nullptr;
    check_failed(draw(c, camera), RYE_ERROR_ARGUMENT, "cloud: scale: got a null pointer");
    rye_camera k = camera;
    k.width = 0;
    check_failed(draw(cloud, k), RYE_ERROR_ARGUMENT, "the picture has 0 x 40 pixels");
    k = camera;
    k.fx = std::nanf("");
    check_failed(draw(cloud, k), RYE_ERROR_ARGUMENT, "'fx' is nan");
    k = camera;
    k.camera_from_world[0] = 3;
    check_failed(draw(cloud, k), RYE_ERROR_ARGUMENT, "'rotation' is no rotation");
    k = camera;
    k.camera_from_world[15] = 2;
    check_failed(draw(cloud, k), RYE_ERROR_ARGUMENT, "the last row is no 0 0 0 1");
    CHECK((feature.array() == -7).all());

    REQUIRE(draw(cloud, camera) == RYE_OK);
    c = cloud;
    c.count = 3;
    check_failed(rye_draw_gradient(renderer, &c, &g_image, &g_cloud), RYE_ERROR_STATE,
                 "got a cloud of 3 Gaussians, expected the 200");
    feature(3, 2) = std::nanf("");
    g_image.feature = feature.data();
    check_failed(rye_draw_gradient(renderer, &cloud, &g_image, &g_cloud), RYE_ERROR_ARGUMENT,
                 "image: feature: value 13 is nan");

    rye_options options = RYE_INIT(rye_options);
    options.threads = -1;
    rye_renderer* none = nullptr;
    check_failed(rye_renderer_create(&options, &none), RYE_ERROR_ARGUMENT, "threads: got -1");
    options.threads = 0;
    options.accuracy = 9;
    check_failed(rye_renderer_create(&options, &none), RYE_ERROR_ARGUMENT, "accuracy: got 9");
    CHECK(none == nullptr);
    rye_look look = RYE_INIT(rye_look);
    look.width = look.height = 8;
    look.vertical_fov = 4;
    rye_camera looked = RYE_INIT(rye_camera);
    check_failed(rye_camera_look_at(&look, &looked), RYE_ERROR_ARGUMENT, "field of view is 4");
    std::thread([] { CHECK(std::string(rye_message()) == "no call has failed"); }).join();
    rye_renderer_destroy(renderer);
    rye_renderer_destroy(nullptr);
    CHECK(rye_c_version() == RYE_C_VERSION);
}

TEST_CASE(
    "C interface: a Gaussian that is not finite is counted, and no Gaussians are a background") {
    CloudScene s;
    s.g.mean(1, 4) = std::nanf("");
    rye_cloud cloud = s.cloud();
    const rye_camera camera = s.c_camera();
    rye_renderer* renderer = renderer_of(1);
    Columns<float> feature(5, 48 * 40);
    rye_image image = RYE_INIT(rye_image);
    image.feature = feature.data();
    REQUIRE(rye_draw(renderer, &cloud, &camera, s.background.data(), &image) == RYE_OK);
    CHECK(image.skipped == 1);
    CHECK(feature.allFinite());
    cloud.count = 0;
    cloud.mean = nullptr;
    REQUIRE(rye_draw(renderer, &cloud, &camera, s.background.data(), &image) == RYE_OK);
    CHECK((feature.array() == 0.25F).all());
    rye_renderer_destroy(renderer);
}

TEST_CASE(
    "C interface: an avatar by its drivers is the player's picture; gazes move a part of it") {
    const TemporaryFolder folder;
    const std::string path = (folder.path / "a.avatar").string();
    const PlayableAvatar<float> p = tiny_playable(TinyParts{true, true, true, true, true});
    write_avatar(path, p, AvatarPrecision::full);
    AvatarPlayer<XsimdBackend<>> player(XsimdBackend<>(), p);
    const Bytes bytes = read_file(path);
    for (const bool memory : {false, true}) {
        rye_avatar* avatar = nullptr;
        REQUIRE((memory ? rye_avatar_open_memory("a", bytes.data(), bytes.size(), nullptr, &avatar)
                        : rye_avatar_open(path.c_str(), nullptr, &avatar)) == RYE_OK);
        rye_avatar_info info = RYE_INIT(rye_avatar_info);
        REQUIRE(rye_avatar_describe(avatar, &info) == RYE_OK);
        CHECK(info.expression_count == 3);
        CHECK(info.channels == 5);
        CHECK(info.visual_axes == 1);
        CHECK(info.gaussians == 78);
        CHECK(std::string(info.name) == p.name);
        CHECK(std::string(info.expression_names[2]) == "smile");
        CHECK(info.expression_high[1] == 1.0F);
        CHECK(info.gaze_low[1][0] == -0.4F);
        CHECK(info.radius > 0.1F);
        rye_avatar_work work = RYE_INIT(rye_avatar_work);
        check_failed(rye_avatar_last_work(avatar, &work), RYE_ERROR_STATE, "has drawn no picture");
        rye_drivers d = RYE_INIT(rye_drivers);
        rye_camera camera = RYE_INIT(rye_camera);
        REQUIRE(rye_avatar_neutral(avatar, &d, &camera) == RYE_OK);
        Columns<float> rgb(3, camera.width * camera.height);
        std::vector<std::uint8_t> rgba(static_cast<std::size_t>(4 * rgb.cols()));
        rye_picture picture = RYE_INIT(rye_picture);
        picture.rgb = rgb.data();
        picture.rgba = rgba.data();
        REQUIRE(rye_avatar_draw(avatar, &d, &camera, nullptr, &picture) == RYE_OK);
        check_close(rgb, player.draw(p.neutral, p.camera, p.background).pixels);
        CHECK(rgba[3] == 255);
        CHECK(std::abs(float(rgba[4]) - 255 * std::clamp(rgb(0, 1), 0.0F, 1.0F)) <= 0.51F);

        d.gaze[1][0] = 0.2F;
        d.gaze[1][1] = -0.1F;
        REQUIRE(rye_avatar_draw(avatar, &d, &camera, nullptr, &picture) == RYE_OK);
        Drivers<float> turned = p.neutral;
        turned.gaze[1] = gaze_vector<float>(0.2F, -0.1F);
        check_close(rgb, player.draw(turned, p.camera, p.background).pixels);
        REQUIRE(rye_avatar_last_work(avatar, &work) == RYE_OK);
        CHECK(work.networks == 3);
        CHECK(work.gaussians > 0);
        CHECK(work.gaussians < 78);
        rye_cloud cloud = RYE_INIT(rye_cloud);
        REQUIRE(rye_avatar_gaussians(avatar, &cloud) == RYE_OK);
        CHECK(cloud.count == 78);
        CHECK(cloud.mean[3] == doctest::Approx(player.gaussians().mean(0, 1)));

        // Without a picture: the same Gaussians, and a later picture that is whole.
        rye_avatar* apart = nullptr;
        REQUIRE(rye_avatar_open(path.c_str(), nullptr, &apart) == RYE_OK);
        check_failed(rye_avatar_gaussians(apart, &cloud), RYE_ERROR_STATE, "nor rye_avatar_drive");
        float dilation = 0;
        check_failed(rye_avatar_dilation(apart, &dilation), RYE_ERROR_STATE, "nor rye_avatar_drive");
        REQUIRE(rye_avatar_drive(apart, &d, &camera) == RYE_OK);
        REQUIRE(rye_avatar_dilation(apart, &dilation) == RYE_OK);
        CHECK(dilation == static_cast<float>(player.dilation()));
        REQUIRE(rye_avatar_gaussians(apart, &cloud) == RYE_OK);
        check_close(Eigen::Map<const Columns<float>>(cloud.feature, 5, 78),
                    player.gaussians().feature);
        check_close(Eigen::Map<const Columns<float>>(cloud.mean, 3, 78), player.gaussians().mean);
        REQUIRE(rye_avatar_last_work(apart, &work) == RYE_OK);
        CHECK(work.gaussians == 78);
        CHECK(work.tiles == 0);
        REQUIRE(rye_avatar_draw(apart, &d, &camera, nullptr, &picture) == RYE_OK);
        check_close(rgb, player.draw(turned, p.camera, p.background).pixels);
        rye_drivers ahead = RYE_INIT(rye_drivers);
        REQUIRE(rye_avatar_neutral(apart, &ahead, &camera) == RYE_OK);
        REQUIRE(rye_avatar_drive(apart, &ahead, &camera) == RYE_OK);
        REQUIRE(rye_avatar_draw(apart, &ahead, &camera, nullptr, &picture) == RYE_OK);
        check_close(rgb, player.draw(p.neutral, p.camera, p.background).pixels);
        rye_upsampler network = RYE_INIT(rye_upsampler);
        REQUIRE(rye_avatar_upsampler(apart, &network) == RYE_OK);
        const Upsampler<float>& right = p.avatar.upsampler;
        CHECK(network.channels == 5);
        CHECK(network.capacity == right.shape.capacity);
        CHECK(network.doublings == right.shape.doublings);
        CHECK((network.skip == 1) == right.shape.skip);
        CHECK((network.normalized == 1) == (right.shape.norm == Normalization::instance));
        CHECK(network.convolution[1][3] == right.conv[1](3));
        CHECK(network.out_weight[4] == right.out_weight(4));
        CHECK(network.out_bias[2] == right.out_bias(2));
        const float pupils[2] = {1.5F, 0.7F}, wide[2] = {1, 2.5F};
        REQUIRE(rye_avatar_pupils(apart, pupils) == RYE_OK);
        REQUIRE(rye_avatar_draw(apart, &ahead, &camera, nullptr, &picture) == RYE_OK);
        const Columns<float> rest = player.draw(p.neutral, p.camera, p.background).pixels;
        player.set_pupils({1.5F, 0.7F});
        CHECK(player.draw(p.neutral, p.camera, p.background).pixels != rest);
        check_close(rgb, player.draw(p.neutral, p.camera, p.background).pixels);
        player.set_pupils({1, 1});
        check_failed(rye_avatar_pupils(apart, wide), RYE_ERROR_ARGUMENT,
                     "pupil: got the ratio 2.5 for the right eye, expected 0.4 to 2");
        ahead.scale = -1;
        check_failed(rye_avatar_drive(apart, &ahead, &camera), RYE_ERROR_ARGUMENT, "'scale': got -1");
        check_failed(rye_avatar_gaussians(apart, &cloud), RYE_ERROR_STATE, "nor rye_avatar_drive");
        rye_avatar_close(apart);

        rye_drivers wrong = d;
        wrong.expression_count = 4;
        check_failed(rye_avatar_draw(avatar, &wrong, &camera, nullptr, &picture),
                     RYE_ERROR_ARGUMENT, "expression_count: got 4, expected 3");
        wrong = d;
        wrong.gaze[0][1] = 2;
        check_failed(rye_avatar_draw(avatar, &wrong, &camera, nullptr, &picture),
                     RYE_ERROR_ARGUMENT, "gaze: got 2 rad, expected at most 1.57");
        wrong = d;
        float missed[2] = {-1, -1};
        const Vec3<float> world = head_placement(p.neutral).world_from_head.apply(
            Vec3<float>(p.neutral.scale * Vec3<float>(0.5F, 0.2F, 6)));
        REQUIRE(rye_avatar_gaze_at(avatar, &wrong, world.data(), 0.8F, missed) == RYE_OK);
        CHECK(missed[0] == 0);
        const auto aimed = gazes_at(ScalarBackend<>{}, p.avatar.eyes, p.config, p.neutral,
                                    {Vec3<float>(0.5F, 0.2F, 6)});
        for (std::size_t e = 0; e < 2; ++e)
            CHECK(
                (gaze_vector<float>(wrong.gaze[e][0], wrong.gaze[e][1]) - aimed[e].visual).norm() <
                1e-5F);
        const float behind[3] = {1, 0, -9}, nowhere[3] = {0, std::nanf(""), 1};
        REQUIRE(rye_avatar_gaze_at(avatar, &wrong, behind, 0.8F, missed) == RYE_OK);
        CHECK(missed[1] > 1);
        check_failed(rye_avatar_gaze_at(avatar, &wrong, nowhere, 0.8F, nullptr), RYE_ERROR_ARGUMENT,
                     "point: value 1 is nan");
        check_failed(rye_avatar_gaze_at(avatar, &wrong, behind, 2, nullptr), RYE_ERROR_ARGUMENT,
                     "range: got 2 rad");
        const HeadPlacement<float> head = head_placement(p.neutral);
        const Vec3<float> eye = head.world_from_head.apply(
            Vec3<float>(head.scale * driven_eye_centres(ScalarBackend<>{}, p.avatar.eyes, p.config,
                                                        p.neutral)[0]));
        check_failed(rye_avatar_gaze_at(avatar, &wrong, eye.data(), 0.8F, nullptr),
                     RYE_ERROR_ARGUMENT, "point: lies inside the left eye");
        // By itself: gazes turn, lids by names close, as the headers have it.
        std::vector<float> lids(3);
        wrong = d;
        REQUIRE(rye_avatar_idle(avatar, &wrong, lids.data(), 7, 12.5, 0.5F) == RYE_OK);
        Drivers<float> lives = turned;
        add_idle(IdleEyes({}, 7, 3600).at(12.5),
                 lid_coefficients(p.expression_names, p.ranges.expression_high), 0.5, lives);
        for (std::size_t e = 0; e < 2; ++e)
            CHECK((gaze_vector<float>(wrong.gaze[e][0], wrong.gaze[e][1]) - lives.gaze[e]).norm() <
                  1e-6F);
        CHECK((lives.gaze[0] - turned.gaze[0]).norm() > 1e-3F);
        CHECK(wrong.expression == lids.data());
        CHECK(Eigen::Map<const VecX<float>>(lids.data(), 3) == lives.expression);
        wrong = d;
        REQUIRE(rye_avatar_idle(avatar, &wrong, nullptr, 7, 12.5, 0.5F) == RYE_OK);
        CHECK(wrong.expression == d.expression);
        check_failed(rye_avatar_idle(avatar, &wrong, nullptr, 7, -1, 0.5F), RYE_ERROR_ARGUMENT,
                     "seconds: got -1, expected 0 to 3600");
        check_failed(rye_avatar_idle(avatar, &wrong, nullptr, 7, 1, 0), RYE_ERROR_ARGUMENT,
                     "range: got 0 rad");
        wrong = d;
        wrong.scale = 0;
        check_failed(rye_avatar_draw(avatar, &wrong, &camera, nullptr, &picture),
                     RYE_ERROR_ARGUMENT, "'scale': got 0");
        rye_avatar_close(avatar);
    }
    rye_avatar_close(nullptr);
    rye_avatar* none = nullptr;
    check_failed(rye_avatar_open("/nowhere/a.avatar", nullptr, &none), RYE_ERROR_FILE,
                 "/nowhere/a");
    check_failed(rye_avatar_open_memory("page", "rubbish", 7, nullptr, &none), RYE_ERROR_FILE,
                 "page");
    CHECK(none == nullptr);
}

#ifdef RYE_HAS_LIMITS
TEST_CASE("C interface: where the system starts few threads, objects draw the same with those") {
    const CloudScene s;
    const rye_cloud cloud = s.cloud();
    const rye_camera camera = s.c_camera();
    const auto drawn = [&](int threads) {
        rye_renderer* renderer = renderer_of(threads);
        Columns<float> feature(5, 48 * 40);
        rye_image image = RYE_INIT(rye_image);
        image.feature = feature.data();
        REQUIRE(rye_draw(renderer, &cloud, &camera, s.background.data(), &image) == RYE_OK);
        rye_renderer_destroy(renderer);
        return feature;
    };
    const Columns<float> expected = drawn(1);
    const TemporaryFolder folder;
    write_avatar((folder.path / "a.avatar").string(), tiny_playable(true), AvatarPrecision::full);
    const Bytes bytes = read_file((folder.path / "a.avatar").string());
    const auto same = [&] {
        rye_options options = RYE_INIT(rye_options);
        options.threads = 1000;
        rye_avatar* avatar = nullptr;
        if (rye_avatar_open_memory("a", bytes.data(), bytes.size(), &options, &avatar) != RYE_OK)
            return false;
        rye_avatar_close(avatar);
        return drawn(1000) == expected;
    };
    CHECK(in_child(20, [&] { return limit_threads(5) && same(); }) == "");
    CHECK(in_child(20, [&] { return limit_memory(256 << 20) && same(); }) == "");
}
#endif
