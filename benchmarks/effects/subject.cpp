// SPDX-License-Identifier: Apache-2.0
#include "subject.hpp"

#include <cstdlib>
#include <optional>

#include <rye/avatar/hold.hpp>
#include <rye/avatar/playable.hpp>
#include <rye/io/avatar_file.hpp>

#if __has_include("commands/options.hpp") // the trainer is built, too
#define RYE_BENCH_TRAINED
#include "commands/options.hpp"
#include "model/run.hpp"
#endif

namespace rye::bench {

SubjectOptions& subject_options() {
    static SubjectOptions options;
    return options;
}

namespace {

#ifdef RYE_BENCH_TRAINED
std::optional<Subject> trained(const SubjectOptions& o) {
    if (o.run.empty()) return std::nullopt;
    const trainer::TrainState state = trainer::load_trained(o.run);
    const trainer::Capture capture =
        trainer::read_capture(o.capture.empty() ? state.capture : o.capture);
    const int frame = trainer::frame_index(capture, "");
    const int camera = trainer::camera_index(capture, "", frame);
    const int doublings = state.config.gaussians.upsampler.doublings;
    return Subject{"a trained avatar",
                   state.avatar,
                   state.config.avatar,
                   state.subject.roles,
                   restricted<TrainedEffects>(
                       trainer::frame_drivers(capture, frame, state.config.gaze_axis)),
                   scaled(capture.camera(frame, camera).cast<float>(), 1.0 / (1 << doublings)),
                   VecX<float>::Ones(state.config.avatar.channels)};
}
#else
std::optional<Subject> trained(const SubjectOptions&) { return std::nullopt; }
#endif

std::optional<Subject> from_file(const std::string& avatar) {
    if (avatar.empty()) return std::nullopt;
    const PlayableAvatar<float> p = read_avatar<float>(avatar);
    const int factor = 1 << p.avatar.upsampler.shape.doublings;
    return Subject{"the avatar of a file",
                   p.avatar,
                   p.config,
                   p.roles,
                   restricted<TrainedEffects>(p.neutral),
                   render_camera(p.camera, factor),
                   p.background};
}

/// An avatar of half the Gaussians that `rye train --preset cpu` makes of a capture with 452
/// landmarks; points on an ellipsoid, networks as initialised.
Subject synthetic() {
    constexpr Index points = 19326, eye_points = 2410;
    constexpr int landmarks = 452;
    Subject s{};
    s.name = "a synthetic avatar of a trained one's sizes (no --run, no --avatar)";
    AvatarConfig& c = s.config;
    c.expression = 45;
    c.feature = 32;
    c.channels = 8;
    c.networks = {{64, 64, 64, 64}, {64, 64}, {64}, {64, 64, 64, 64}, {64, 64},
                  {64, 64},         {64},     {64, 64, 64}, {64},     {64, 64}};
    const Random random{3, 1};
    std::uint64_t next = 0;
    const auto normal = [&] { return static_cast<float>(random.normal(next++)); };
    const auto columns = [&](Index rows, Index cols, float size, float middle) {
        Columns<float> a(rows, cols);
        for (Index i = 0; i < a.size(); ++i) a(i) = middle + size * normal();
        return a;
    };
    const auto on_head = [&](bool face) {
        Vec3<float> d = Vec3<float>(normal(), normal(), normal()).normalized();
        if (face) d.z() = std::abs(d.z());
        return Vec3<float>(0.75f * d.x(), d.y(), 0.95f * d.z());
    };
    FaceStream<float, TrainedEffects>& f = s.avatar.face;
    f.position.resize(3, points);
    for (Index i = 0; i < points; ++i) f.position.col(i) = on_head(i % 3 != 0);
    f.feature = columns(c.feature, points, 1, 0);
    f.log_scale = columns(3, points, 0.3f, -4.2f);
    f.rotation = columns(4, points, 1, 0);
    f.opacity_logit = columns(1, points, 1, 1);
    f.networks = FaceNetworks<float, TrainedEffects>::init(c, Random{1, 0});
    f.exp_attributes = Mlp<float>::init(
        mlp_shape(c.feature, c.expression, c.networks.exp_attributes, 8), Random{2, 0});
    f.pose_attributes = Mlp<float>::init(
        mlp_shape(c.feature, c.pose_code(), c.networks.pose_attributes, 8), Random{3, 0});
    f.landmarks.resize(3, landmarks);
    for (Index k = 0; k < landmarks; ++k) {
        f.landmarks.col(k) = on_head(true);
        if (k < 12) {
            const std::size_t e = k < 6 ? 0 : 1;
            s.roles.eye[e].push_back(k);
            f.landmarks.col(k) << (e == 0 ? 0.3f : -0.3f) + 0.1f * normal(), 0.15f, 0.85f;
        } else {
            s.roles.expression.push_back(k);
        }
    }
    EyeStream<float, TrainedEffects>& e = s.avatar.eyes;
    e.feature = columns(c.channels, 2 * eye_points, 0.3f, 0.5f);
    e.log_scale = columns(3, 2 * eye_points, 0.2f, -5.3f);
    e.rotation = columns(4, 2 * eye_points, 1, 0);
    e.opacity_logit = columns(1, 2 * eye_points, 0.5f, 2);
    e.offset = EyeOffsetNetwork<float>::init(c, Random{4, 0});
    e.position.resize(3, 2 * eye_points);
    for (Index i = 0; i < 2 * eye_points; ++i)
        e.position.col(i) = 0.12f * Vec3<float>(normal(), normal(), normal()).normalized();
    e.spacing = Columns<float>::Constant(1, 2 * eye_points, 0.005f);
    e.centre.resize(3, 2);
    e.centre << 0.3f, -0.3f, 0.15f, 0.15f, 0.8f, 0.8f;
    const MlpShape eye_network = DrivenFeatures::shape(appearance_sizes<TrainedEffects>(c, 0));
    for (std::size_t eye = 0; eye < 2; ++eye)
        e.networks[eye] = Mlp<float>::init(eye_network, Random{6 + eye, 0});
    s.avatar.shading = initial_shading<float>(f.position.colwise().normalized());
    s.avatar.shading.light.setConstant(0.2f);
    s.avatar.upsampler = Upsampler<float>::init({.in_channels = c.channels,
                                                 .capacity = 8,
                                                 .doublings = 0,
                                                 .norm = Normalization::none,
                                                 .skip = true},
                                                Random{5, 0});
    s.avatar.upsampler.out_weight.setConstant(0.05f);
    s.drivers.expression = columns(c.expression, 1, 0.3f, 0).col(0);
    s.drivers.pose << 0.1f, -0.05f, 0.02f, 0.03f, -0.02f, 0.01f;
    s.drivers.gaze = {Vec3<float>::UnitZ(), Vec3<float>::UnitZ()};
    s.camera = look_at<float>({0, 0, 10}, {0, 0, 0}, {0, 1, 0}, 0.25f, {256, 256});
    s.background = VecX<float>::Ones(c.channels);
    return s;
}

} // namespace

const Subject& subject() {
    static const Subject s = [] {
        SubjectOptions o = subject_options();
        const auto from = [](std::string& option, const char* variable, const char* below) {
            const char* const value = std::getenv(variable);
            if (option.empty() && value != nullptr && *value != '\0')
                option = std::string(value) + below;
        };
        from(o.run, "RYE_RUN", "");
        from(o.capture, "RYE_DATA", "/capture_a");
        std::optional<Subject> found = from_file(o.avatar);
        if (!found) found = trained(o);
        Subject shown = found ? *found : synthetic();
        shown.drivers = seen_from(shown.drivers, shown.camera);
        return shown;
    }();
    return s;
}

} // namespace rye::bench
