// SPDX-License-Identifier: Apache-2.0
/// Training as a whole: a small head trained for seconds must render held-out frames, with their
/// gaze; without the gradients of any one stream it must not. A gradient that is zero, or of the
/// wrong sign, fails here even if the laws of single kernels hold.
#include <array>
#include <cmath>
#include <filesystem>
#include <string>
#include <utility>

#include <doctest/doctest.h>

#include <rye/core/random.hpp>

#include "../support/hostile.hpp"
#include "evaluation/evaluation.hpp"
#include "synthetic_capture/scene.hpp"
#include "training/steps.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

/// Few frames and cameras, close enough for eyes of measurable size.
Capture small_capture(const fs::path& folder) {
    const HeadModel model = procedural_head(1);
    CaptureSettings settings;
    settings.size = 96;
    settings.cameras = 3;
    settings.train_frames = 6;
    settings.novel_frames = 2;
    settings.independent_frames = 0;
    settings.samples = 2;
    CaptureScene scene = capture_scene(model, settings);
    for (SceneCamera& c : scene.cameras) {
        c.camera.fx *= 2.2;
        c.camera.fy *= 2.2;
    }
    write_capture(model, scene, folder / "capture", [](int, int) {});
    return read_capture(folder / "capture");
}

TrainConfig small_config() {
    TrainConfig c = preset("tiny");
    c.avatar.feature = 16;
    c.avatar.channels = 8;
    c.avatar.networks = {{32, 32}, {32}, {16}, {32, 32}, {16}, {16}, {16}, {16}, {16}, {16}};
    c.grid.cell = 3.5 / 12;
    c.mesh.steps = 120;
    c.mesh.image_size = 48;
    c.mesh.pretrain_steps = 100;
    c.mesh.fit_steps = 200;
    c.gaussians.steps = 400;
    c.gaussians.spacing = 0.03;
    c.gaussians.mouth_points = 50;
    c.gaussians.eyeball.points = 400;
    c.gaussians.upsampler.doublings = 0;
    c.gaussians.upsampler.capacity = 8;
    c.gaussians.upsampler.skip = false; // it must learn to show colours at all
    c.gaussians.rates.upsampler = 5e-3;
    c.gaussians.weights.eye_high_every = 1;
    return c;
}

using Names = bool (*)(const std::string&);
bool none(const std::string&) { return false; }
bool face(const std::string& name) { return name.starts_with("face."); }
bool eyes(const std::string& name) { return name.starts_with("eyes."); }
bool networks(const std::string& name) { return name.find("_mlp.") != std::string::npos; }
bool upsampler(const std::string& name) { return name.starts_with("upsampler."); }

/// Keeps the named fields unchanged: the effect of a gradient of zero.
template <class P>
void keep(P& now, const P& before, Names named) {
    P::fields([&](const std::string& name, auto& a, const auto& b) {
        if (named(name)) a = b;
    }, now, before);
}

/// Trains the first stage without the fields of `kept`.
TrainState mesh_stage(const Capture& capture, Names kept) {
    TrainState s;
    s.config = small_config();
    s.config.avatar.expression = capture.expression_width();
    s.subject = describe_subject(capture, s.config);
    s.train_frames = capture.train;
    s.mesh = Mesh::init(s.config.avatar, s.subject.neutral.cast<float>(), Random{1, 0});
    pretrain_mesh(s);
    s.mesh_adam = Adam<Mesh>(s.mesh);
    const Mesh begin = s.mesh;
    const TetGrid<float> grid = make_lattice(s);
    MeshStepper stepper(s);
    const Random pick{2, 0};
    while (s.step < s.config.mesh.steps) {
        const auto key = static_cast<std::uint64_t>(s.step);
        const int frame = capture.train[static_cast<std::size_t>(
            pick.below(key, static_cast<Index>(capture.train.size())))];
        stepper.step(s, grid, mesh_sample(capture, s.subject, s.config, frame, {0, 1, 2}), 1,
                     [](const char*) {});
        keep(s.mesh, begin, kept);
    }
    fit_landmarks(s, capture);
    keep(s.mesh, begin, kept);
    begin_avatar(s, grid);
    return s;
}

/// Trains the second stage without the fields of `kept`, ready for rendering.
TrainState avatar_stage(const Capture& capture, TrainState s, Names kept) {
    const Avatar begin = s.avatar;
    const std::unique_ptr<AvatarSteps> steps = avatar_steps(s, {});
    const Random pick{3, 0}, color{4, 0};
    const int total = s.config.gaussians.steps;
    while (s.step < total) {
        const auto key = static_cast<std::uint64_t>(s.step);
        const int frame = capture.train[static_cast<std::size_t>(
            pick.below(2 * key, static_cast<Index>(capture.train.size())))];
        const int camera = static_cast<int>(pick.below(2 * key + 1, capture.camera_count()));
        AvatarSample<float> sample = avatar_sample(capture, s.config, frame, camera);
        for (Index c = 0; c < sample.blank.size(); ++c)
            sample.blank(c) = static_cast<float>(
                color.fork(key).uniform(static_cast<std::uint64_t>(c)));
        const double rate = std::pow(0.1, static_cast<double>(s.step) / total);
        steps->step(s, sample, rate, [](const char*) {});
        keep(s.avatar, begin, kept);
    }
    return drawn_state(s);
}

struct Figures {
    double psnr, gaze;
    int visible;
};

/// On the held-out frames.
Figures figures_of(const Capture& capture, const TrainState& drawn) {
    const Evaluation evaluation(drawn, capture);
    ViewResult all;
    Image<float> picture;
    for (const int f : capture.test)
        for (int c = 0; c < capture.camera_count(); ++c) all.add(evaluation.view(f, c, picture));
    return {all.head.psnr.value(), all.measured.render.to_photograph.value(), all.eyes_visible};
}

/// Whether both eyes count: the row without labels has the same bits when the labels of the
/// eyeballs are moved and the eye masks changed, and the other row has not.
void check_reads_no_label(Capture& capture, const TrainState& drawn) {
    const Evaluation evaluation(drawn, capture);
    Image8 halves{capture.width, capture.height, 1, {}};
    for (int y = 0; y < halves.height; ++y)
        for (int x = 0; x < halves.width; ++x)
            halves.values.push_back(2 * x < halves.width ? 170 : 85);
    const fs::path other = capture.folder / "another_eye_mask.png";
    write_png(other, halves);
    int compared = 0, found = 0;
    Image<float> picture;
    for (const int f : capture.test)
        for (int c = 0; c < capture.camera_count(); ++c) {
            const ViewResult before = evaluation.view(f, c, picture);
            if (before.eyes_visible < 2) continue;
            CaptureFrame& frame = capture.frames[static_cast<std::size_t>(f)];
            const std::array<CaptureEye, 2> labels = frame.eyes;
            for (CaptureEye& eye : frame.eyes) {
                eye.centre = *eye.centre + Vec3<double>(0.03, -0.02, 0.01);
                eye.radius = 1.2 * *eye.radius;
                eye.limbus_radius = 1.3 * *eye.limbus_radius;
            }
            CaptureView& view =
                capture.views[static_cast<std::size_t>(f * capture.camera_count() + c)];
            const fs::path mask = std::exchange(view.eye_mask, other);
            const ViewResult after = evaluation.view(f, c, picture);
            frame.eyes = labels;
            view.eye_mask = mask;
            CHECK(after.eyes_visible == 2);
            CHECK(after.own.json() == before.own.json());
            CHECK(after.measured.json() != before.measured.json());
            ++compared;
            found += before.own.photograph.found + before.own.render.found;
        }
    CHECK(compared >= 2);
    CHECK(found >= 4); // so that equal results are not due to missing irises
}

constexpr double psnr_bound = 18.5, gaze_bound = 15;

} // namespace

TEST_CASE("training learns a head and its gaze") {
    const TemporaryFolder folder;
    Capture capture = small_capture(folder.path);
    const TrainState state = mesh_stage(capture, none);
    const TrainState trained = avatar_stage(capture, state, none);
    const Figures whole = figures_of(capture, trained);
    MESSAGE("PSNR " << whole.psnr << " dB, gaze error " << whole.gaze << " degrees over "
                    << whole.visible << " eyes");
    CHECK(whole.visible >= 8);
    CHECK(whole.psnr >= psnr_bound);
    CHECK(whole.gaze <= gaze_bound);
    check_reads_no_label(capture, trained);
}

TEST_CASE("streams: training does not learn without any one of them") {
    const TemporaryFolder folder;
    const Capture capture = small_capture(folder.path);
    const TrainState state = mesh_stage(capture, none);
    const std::array<std::pair<std::string, Names>, 4> streams{
        {{"face", face}, {"eyes", eyes}, {"networks", networks}, {"upsampler", upsampler}}};
    for (const auto& [name, kept] : streams) {
        // The first stage trains networks and little else.
        const TrainState begin = kept == networks ? mesh_stage(capture, kept) : state;
        const Figures part = figures_of(capture, avatar_stage(capture, begin, kept));
        MESSAGE("without " << name << ": PSNR " << part.psnr << " dB, gaze error " << part.gaze
                           << " degrees");
        CHECK((part.psnr < psnr_bound || part.gaze > gaze_bound));
    }
}
