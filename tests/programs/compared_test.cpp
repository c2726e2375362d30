// SPDX-License-Identifier: Apache-2.0
#include "model/compared.hpp"

#include <map>

#include <doctest/doctest.h>

#include <rye/io/safetensors.hpp>
#include <rye/rig/eyeball.hpp>

#include "../support/hostile.hpp"
#include "drawing/playable.hpp"
#include "drawing/shown.hpp"
#include "drawing/variants.hpp"
#include "tiny_capture.hpp"
#include "tiny_run.hpp"
#include "training/steps.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

using Name = GazeMechanismName;
constexpr std::array<Name, 5> compared{Name::feature_rotation, Name::condition,
                                       Name::latent_rotation, Name::learned_quaternion, Name::none};

/// Eyeballs of two hundred Gaussians without a face, of the same grey.
TrainState eyes_alone() {
    TrainState s = tiny_state();
    TrainEyeball shape = eyeball_shape({0.12, 0.06, 0.1});
    shape.iris_rings = 6;
    shape.sclera_rings = 6;
    shape.back_rings = 3;
    const EyeballTemplate<float> ball = eyeball_template<float>(shape);
    const Index n = ball.points.cols();
    s.avatar.face.opacity_logit.setConstant(-20);
    EyeStream<float, TrainEffects>& e = s.avatar.eyes;
    e.left_points = n;
    e.position = ball.points.replicate(1, 2);
    e.spacing = ball.spacing.replicate(1, 2);
    e.log_scale = (0.7f * e.spacing).array().log().replicate(3, 1);
    e.rotation = Columns<float>::Zero(4, 2 * n);
    e.rotation.row(0).setOnes();
    e.opacity_logit = Columns<float>::Constant(1, 2 * n, 3);
    e.feature = Columns<float>::Constant(s.config.avatar.channels, 2 * n, 0.5f);
    e.offset.mlp.weight.back().setZero();
    e.offset.mlp.bias.back().setZero();
    s.avatar_adam = Adam<Avatar>(s.avatar);
    AvatarTrainConfig& g = s.config.gaussians;
    g.weights = {};
    g.weights.high_resolution = g.weights.low_resolution = g.weights.perceptual = 0;
    g.weights.blank = g.weights.eye_high = 0;
    g.weights.eye_low = 1;
    g.eyeball.max_growth = 0;
    g.rates = {0, 1e-2, 0, 0, 0, 0, 0, 0, 2e-2, 0, 0};
    return s;
}

/// The same run with another mechanism.
TrainState with(Name mechanism, TrainState s) {
    s.config.gaze_mechanism = mechanism;
    ComparedTraining& t = s.compared.emplace();
    const Columns<float> normals =
        Vec3<float>(0, 0, 1).replicate(1, s.avatar.face.position.cols());
    t.avatar = compared_avatar(s.avatar, s.config, normals, Random{3, 0});
    t.adam = Adam<ComparedAvatar>(t.avatar);
    s.avatar = {};
    s.avatar_adam = {};
    return s;
}

Drivers<float> looking(const TrainState& s, float pitch, float yaw) {
    Drivers<float> d = neutral_drivers<float>(s.config.avatar);
    d.gaze.fill(gaze_vector(pitch, yaw));
    return d;
}

Pinhole<float> camera() {
    return look_at<double>(Vec3<double>(0, 0.3, 6), Vec3<double>(0, 0.3, 0.9),
                           Vec3<double>(0, 1, 0), 0.2, {96, 64})
        .cast<float>();
}

/// Both eyes with a black iris, looking somewhere, as a sample of the eyes alone.
AvatarSample<float> sample_of(const TrainState& painted, float pitch, float yaw) {
    AvatarSample<float> s;
    s.drivers = looking(painted, pitch, yaw);
    s.frame = -1;
    s.camera = reduced(camera(), 2);
    s.truth_small = rgb_of(render_avatar(painted, {s.drivers, camera()}, true).eyes);
    s.truth = Image<float>(96, 64, 3);
    s.truth.pixels.setConstant(0.5f);
    const Index pixels = s.truth_small.size();
    for (Columns<float>* a : {&s.visible_small, &s.eyes_small, &s.mask_small})
        *a = Columns<float>::Ones(1, pixels);
    for (Columns<float>* a : {&s.visible, &s.eyes}) *a = Columns<float>::Ones(1, 4 * pixels);
    s.background = s.blank = VecX<float>::Ones(painted.config.avatar.channels);
    s.eyes_high = false;
    return s;
}

/// The mean error over four gazes after some steps of training on them.
double error_after_training(TrainState s, const std::vector<AvatarSample<float>>& samples) {
    const std::unique_ptr<AvatarSteps> steps = avatar_steps(s, {});
    const auto probe = [](const char*) {};
    double last = 0;
    constexpr int rounds = 50;
    for (int round = 0; round < rounds; ++round)
        for (const AvatarSample<float>& sample : samples) {
            const StepReport r = steps->step(s, sample, 1, probe);
            REQUIRE(r.bad_field.empty());
            if (round + 1 == rounds)
                for (const auto& [name, value] : r.losses)
                    if (name == "eye_low") last += value / static_cast<double>(samples.size());
        }
    return last;
}

} // namespace

TEST_CASE("each gaze mechanism fits eyes that look about better than eyes that do not") {
    const TrainState grey = eyes_alone();
    TrainState painted = grey;
    for (Index i = 0; i < painted.avatar.eyes.position.cols(); ++i)
        painted.avatar.eyes.feature.col(i).setConstant(
            painted.avatar.eyes.position(2, i) > 0.095f ? 0.f : 1.f);
    std::vector<AvatarSample<float>> samples;
    for (const float yaw : {-0.4f, 0.4f})
        for (const float pitch : {-0.3f, 0.3f}) samples.push_back(sample_of(painted, pitch, yaw));
    const double fixed = error_after_training(with(Name::none, grey), samples);
    CHECK(fixed > 0.01);
    std::map<Name, double> errors{{Name::rotation, error_after_training(grey, samples)}};
    for (const Name m : compared)
        if (m != Name::none) errors[m] = error_after_training(with(m, grey), samples);
    for (const auto& e : errors) {
        INFO(word_of(e.first) << ": " << e.second << ", fixed: " << fixed);
        CHECK(e.second < 0.8 * fixed);
    }
}

TEST_CASE("features of the eyes are smoothed as they are driven, whatever makes them") {
    TrainState grey = eyes_alone();
    grey.config.gaussians.weights.eye_low = 0;
    grey.config.gaussians.weights.eye_smooth = 1;
    const AvatarSample<float> sample = sample_of(grey, 0.2f, -0.1f);
    for (const Name m : compared) {
        INFO(word_of(m));
        TrainState s = with(m, grey);
        const std::unique_ptr<AvatarSteps> steps = avatar_steps(s, {});
        double first = 0, last = 0;
        for (int k = 0; k < 40; ++k)
            for (const auto& [name, value] :
                 steps->step(s, sample, 1, [](const char*) {}).losses) {
                if (name != "eye_smooth") continue;
                last = value;
                if (k == 0) first = value;
            }
        CHECK(first > 0);
        CHECK(last < 0.7 * first);
    }
}

TEST_CASE("a run by another gaze mechanism comes back from its checkpoint and draws the same") {
    const TemporaryFolder folder;
    for (const Name m : compared) {
        INFO(word_of(m));
        const TrainState state = with(m, eyes_alone());
        save_checkpoint(folder.path, state);
        const TrainState back = load_checkpoint(folder.path);
        CHECK(back.config.gaze_mechanism == m);
        REQUIRE(back.compared.has_value());
        ComparedAvatar::fields(
            [](const std::string& name, const auto& a, const auto& b) {
                INFO(name);
                CHECK((a.array() == b.array()).all());
            },
            back.compared->avatar, state.compared->avatar);
        const Drivers<float> d = looking(state, 0.2f, -0.3f);
        const TrainState drawn = drawn_state(state), drawn_back = drawn_state(back);
        CHECK((render_avatar(drawn, {d, camera()}).high.pixels ==
               render_avatar(drawn_back, {d, camera()}).high.pixels));
        // The gaze is seen in all but one.
        const Columns<float> other =
            render_avatar(drawn, {looking(state, 0, 0), camera()}).high.pixels;
        const bool same = render_avatar(drawn, {d, camera()}).high.pixels == other;
        CHECK(same == (m == Name::none || m == Name::learned_quaternion));
    }
}

TEST_CASE("a run by another gaze mechanism may be shaded, and has its light from the checkpoint") {
    const TemporaryFolder folder;
    TrainState plain = eyes_alone();
    Drivers<float> d = looking(plain, 0.2f, -0.3f);
    d.pose[1] = 0.4f; // shading is relative to the head at rest
    TrainState shaded = plain;
    shaded.config.shading = ShadingName::head_pose;
    TrainState state = with(Name::condition, shaded);
    const auto picture = [&](const TrainState& s) {
        return driven_gaussians(drawn_state(s), d).feature;
    };
    const Columns<float> unshaded = picture(with(Name::condition, plain));
    CHECK((picture(state).array() == unshaded.array()).all()); // light begins at 0
    state.compared->avatar.shading.light.setConstant(0.3f);
    const Columns<float> lit = picture(state);
    CHECK_FALSE((lit.array() == unshaded.array()).all());
    save_checkpoint(folder.path, state);
    CHECK((picture(load_checkpoint(folder.path)).array() == lit.array()).all());
}

TEST_CASE("what a run by another gaze mechanism cannot do is refused by name") {
    const TrainState drawn = drawn_state(with(Name::condition, eyes_alone()));
    const std::vector<DrawnFrame> frames(3, {looking(drawn, 0.1f, 0.2f), camera()});
    const FrameDrawer drawer(drawn, frames, "auto", "--effects", 0.004);
    CHECK(drawer.variant() == "paper");
    CHECK((drawer.picture(frames[1]).pixels == drawer.picture_by_all(frames[1]).pixels));
    CHECK(FrameDrawer(drawn, frames, "paper", "--effects", 0.004).variant() == "paper");
    CHECK_FAULT(FrameDrawer(drawn, frames, "gaze", "--effects", 0.004),
                "--effects: got 'gaze', expected auto or paper");
    const TemporaryFolder folder;
    const TinyCapture files(folder.path);
    const Capture capture = read_capture(folder.path);
    CHECK_FAULT(playable_avatar(drawn, capture, 0, 0),
                "avatar.gaze_mechanism is 'condition', expected 'rotation'");
}

TEST_CASE("a checkpoint whose mechanism does not fit its eyes is refused by the tensor's name") {
    const TemporaryFolder folder;
    const auto saved = [&](Name m, auto&& damage) {
        TrainState s = with(m, eyes_alone());
        damage(s.compared->avatar);
        s.compared->adam = Adam<ComparedAvatar>(s.compared->avatar);
        save_checkpoint(folder.path, s);
    };
    saved(Name::feature_rotation, [](ComparedAvatar& a) {
        std::get<RotatedFeatures::Parameters<float>>(a.eyes.appearance().held)
            .latent.setZero(30, 7);
    });
    CHECK_FAULT(load_checkpoint(folder.path), "tensor 'avatar.eyes.latent': got shape (7, 30)");
    saved(Name::latent_rotation, [](ComparedAvatar& a) {
        auto& p = std::get<RotatedCode::Parameters<float>>(a.eyes.appearance().held);
        p.decoder = Mlp<float>({{90, 3, 5}, 48});
    });
    CHECK_FAULT(load_checkpoint(folder.path), "avatar.eyes.decoder_mlp.conv0.weight");
}

TEST_CASE("configuration: the gaze mechanism by its name, with optical axes alone") {
    TrainConfig c = preset("tiny");
    CHECK(to_json(c)["avatar"]["gaze_mechanism"] == "rotation");
    for (const Name m : compared) {
        from_json({{"avatar", {{"gaze_mechanism", word_of(m)}}}}, "mine.json", c);
        CHECK(c.gaze_mechanism == m);
    }
    const auto read = [&](const char* json) {
        TrainConfig fresh = preset("tiny");
        from_json(nlohmann::ordered_json::parse(json), "mine.json", fresh);
    };
    CHECK_FAULT(read(R"({"avatar": {"gaze_mechanism": "turn"}})"),
                "mine.json: field 'avatar.gaze_mechanism': got \"turn\", expected \"rotation\" or");
    CHECK_FAULT(read(R"({"gaze_axis": "visual", "avatar": {"gaze_mechanism": "condition"}})"),
                "mine.json: field 'avatar.gaze_mechanism': got \"condition\"");
}
