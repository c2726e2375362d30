// SPDX-License-Identifier: Apache-2.0
// `rye refine`: captures with other labels, and the command that writes them.
#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <string>
#include <vector>

#include <rye/io/png.hpp>
#include <rye/train/host_label_drawing.hpp>

#include "../support/file_bytes.hpp"
#include "../support/hostile.hpp"
#include "command_line.hpp"
#include "corrections/gaze_mean.hpp"
#include "data/checksums.hpp"
#include "data/degrees.hpp"
#include "data/json.hpp"
#include "data/samples.hpp"
#include "data/validate.hpp"
#include "importers/face_geometry.hpp"
#include "tiny_scene.hpp"
#include "training/refine.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

struct RefinedScene : TinyScene {
    fs::path out = folder.path / "refined";

    /// Runs the command.
    void command(const std::vector<std::string>& options) const {
        std::vector<std::string> words{"refine", run.string(), "--steps", "2"};
        words.insert(words.end(), options.begin(), options.end());
        const Answer a = answer(words);
        if (a.code != 0) throw Error(a.text);
    }
    void refine(const fs::path& to, const std::string& threads) const {
        command({"--capture", capture.folder.string(), "--out", to.string(), "--threads", threads});
    }
};

} // namespace

TEST_CASE("changed labels: points, centres and axes move with the head, kappa stays") {
    TemporaryFolder folder;
    const TinyCapture tiny(folder.path / "capture");
    LabelChange change;
    change.frame = TinyCapture::frame(1);
    change.gaze = {Vec2<double>(0.05, -0.04), Vec2<double>(-0.03, 0.02)};
    change.pose << 0.02, -0.03, 0.01, 0.05, -0.02, 0.04;
    change.expression = {0.25, -0.125};
    const fs::path out = folder.path / "out";
    write_changed_capture(tiny.folder, out, {change}, HeadPoints::moved);
    const Capture before = read_valid_capture(tiny.folder), after = read_valid_capture(out);
    const CaptureFrame &a = before.frames[1], &b = after.frames[1];
    CHECK((b.pose - a.pose - change.pose).norm() < 1e-12);
    CHECK(b.expression[0] == a.expression[0] + 0.25F);
    CHECK(b.expression[1] == a.expression[1] - 0.125F);
    CHECK((to_canonical(b, b.landmarks) - to_canonical(a, a.landmarks)).cwiseAbs().maxCoeff() <
          1e-6);
    CHECK((to_canonical(b, b.vertices) - to_canonical(a, a.vertices)).cwiseAbs().maxCoeff() <
          1e-12);
    for (std::size_t e = 0; e < 2; ++e) {
        const CaptureEye &from = a.eyes[e], &to = b.eyes[e];
        CHECK((pitch_yaw(to.optical) - pitch_yaw(from.optical) - change.gaze[e]).norm() < 1e-12);
        if (from.visual) {
            CHECK((pitch_yaw(*to.visual) - pitch_yaw(*from.visual) - change.gaze[e]).norm() <
                  1e-12);
        }
        if (from.centre) {
            CHECK((to_canonical(b, *to.centre) - to_canonical(a, *from.centre)).norm() < 1e-12);
        }
        if (to.optical_world) {
            CHECK((*to.optical_world -
                   so3_exp(Vec3<double>(b.pose.head<3>())) * to.optical).norm() < 1e-12);
        }
    }
    // Other frames and the pictures are as they were.
    CHECK(bytes_of(out / "params" / TinyCapture::frame(0) / "params.npz") ==
          bytes_of(tiny.params(0, "params.npz")));
    CHECK(bytes_of(out / fs::relative(tiny.image(1, 2), tiny.folder)) ==
          bytes_of(tiny.image(1, 2)));
    CHECK(!fs::exists(folder.path / "out.partial"));

    const fs::path kept = folder.path / "kept";
    write_changed_capture(tiny.folder, kept, {change}, HeadPoints::kept);
    CHECK(bytes_of(kept / "params" / TinyCapture::frame(1) / "lmk_3d.npy") ==
          bytes_of(tiny.params(1, "lmk_3d.npy")));
}

TEST_CASE("changed labels: a frame without eyeballs gets them, another keeps its own") {
    TemporaryFolder folder;
    const TinyCapture tiny(folder.path / "capture");
    const Capture before = read_capture(tiny.folder);
    CaptureFrame after = before.frame(0);
    CaptureFrame none = after;
    none.has_centres = false;
    for (CaptureEye& e : none.eyes) e.centre.reset();
    for (std::size_t e = 0; e < 2; ++e) {
        after.eyes[e].centre = Vec3<double>(e == 0 ? 0.3 : -0.3, 0.25, 0.75);
        after.eyes[e].radius = 0.125;
        after.eyes[e].limbus_radius = e == 0 ? 0.0625 : 0.046875;
        after.eyes[e].iris_plane = 0.09375;
    }
    after.has_centres = true;
    write_changed_capture(tiny.folder, folder.path / "out", {change_between(none, after)},
                          HeadPoints::kept);
    const Capture out = read_capture(folder.path / "out");
    for (std::size_t e = 0; e < 2; ++e) {
        const CaptureEye& is = out.frame(0).eyes[e];
        CHECK(is.centre == after.eyes[e].centre);
        CHECK(is.radius == after.eyes[e].radius);
        CHECK(is.limbus_radius == after.eyes[e].limbus_radius);
        CHECK(is.iris_plane == after.eyes[e].iris_plane);
        CHECK(out.frame(1).eyes[e].centre == before.frame(1).eyes[e].centre);
        CHECK(out.frame(1).eyes[e].radius == before.frame(1).eyes[e].radius);
    }
}

TEST_CASE("changed labels: what capture.json states of the arrays stays true") {
    TemporaryFolder folder;
    const TinyCapture tiny(folder.path / "capture");
    nlohmann::ordered_json description = {{"subject", "one"},
                                          {"checksums", array_checksums(tiny.folder)}};
    tiny.write_text("capture.json", checked_text(description, 1));
    LabelChange change;
    change.frame = TinyCapture::frame(0);
    change.pose[3] = 0.1;
    write_changed_capture(tiny.folder, folder.path / "out", {change}, HeadPoints::moved);
    CHECK(changed_files(folder.path / "out").empty());
    CHECK(bytes_of(folder.path / "out" / "params" / TinyCapture::frame(0) / "lmk_3d.npy") !=
          bytes_of(tiny.params(0, "lmk_3d.npy")));
}

TEST_CASE("changed labels: a folder that is in use, or in the capture, stays as it is") {
    TemporaryFolder folder;
    const TinyCapture tiny(folder.path / "capture");
    CHECK_FAULT(write_changed_capture(tiny.folder, tiny.folder, {}, HeadPoints::moved),
                "exists already, expected a new or empty folder");
    CHECK_FAULT(write_changed_capture(tiny.folder, tiny.folder / "new", {}, HeadPoints::moved),
                "lies in the capture");
    LabelChange change;
    change.frame = TinyCapture::frame(0);
    change.expression = {1, 2, 3};
    CHECK_FAULT(
        write_changed_capture(tiny.folder, folder.path / "out", {change}, HeadPoints::moved),
        "exp_coeff: got 2 coefficients, expected 3");
    CHECK(!fs::exists(folder.path / "out"));
    CHECK(!fs::exists(folder.path / "out.partial"));
}

TEST_CASE("refine: training frames change, test frames and pictures do not; any threads") {
    const RefinedScene scene;
    scene.refine(scene.out, "1");
    const Capture before = read_valid_capture(scene.capture.folder),
                  after = read_valid_capture(scene.out);
    REQUIRE(!before.test.empty());
    for (const int f : before.test)
        CHECK(bytes_of(scene.out / "params" / TinyCapture::frame(f) / "params.npz") ==
              bytes_of(scene.capture.params(f, "params.npz")));
    std::vector<Vec2<double>> changes;
    Vec2<double> mean = Vec2<double>::Zero();
    for (const int f : before.train) {
        const auto at = static_cast<std::size_t>(f);
        CHECK(after.frames[at].pose != before.frames[at].pose);
        changes.push_back(pitch_yaw(after.frames[at].eyes[0].optical) -
                          pitch_yaw(before.frames[at].eyes[0].optical));
        mean += changes.back() / static_cast<double>(before.train.size());
    }
    auto record = read_json(scene.out / "refine.json");
    CHECK(take_checksum(record) == Checked::right);
    CHECK(record.at("frames").size() == before.train.size());
    const bool outlier =
        std::any_of(record.at("frames").begin(), record.at("frames").end(),
                    [](const auto& f) { return f.at("outlier").template get<bool>(); });
    if (!outlier) {
        // Of the mean change the labels have what their own spread explains.
        const auto n = static_cast<double>(changes.size());
        double variance = 0;
        for (const Vec2<double>& c : changes) variance += (c - mean).squaredNorm() / 2 / (n - 1) / n;
        const auto taken = record.at("mean_taken_off").at("gaze_left").get<std::vector<double>>();
        const Vec2<double> whole = mean + degree * Vec2<double>(taken[0], taken[1]);
        CHECK((mean - mean_error_of_labels(whole, variance)).norm() < 1e-9);
    }
    for (const auto& f : record.at("frames")) CHECK(f.at("cost") <= f.at("cost_before"));

    scene.refine(scene.folder.path / "again", "2");
    for (const int f : before.train)
        for (const char* file : {"params.npz", "gaze.npz", "lmk_3d.npy"})
            CHECK(bytes_of(scene.out / "params" / TinyCapture::frame(f) / file) ==
                  bytes_of(scene.folder.path / "again" / "params" / TinyCapture::frame(f) / file));
}

TEST_CASE("refine: a mean difference of gazes is the labels' error as far as it is likelier") {
    const Vec2<double> mean(0.8 * degree, -0.6 * degree);
    const auto share = [&](double deviation) {
        return mean_error_of_labels(mean, std::pow(deviation * degree, 2)).dot(mean) /
               mean.squaredNorm();
    };
    CHECK(share(0) == 0);
    CHECK(share(0.7) == doctest::Approx(0.5));
    CHECK(share(7) == doctest::Approx(1 / 1.01));
    CHECK(mean_error_of_labels(5 * mean, std::pow(0.7 * degree, 2)).isZero(0)); // a kappa
}

TEST_CASE("refine: a closed eye gets the mean change of the other frames' gazes") {
    const RefinedScene scene;
    const Capture before = read_valid_capture(scene.capture.folder);
    const int shut = before.train.front();
    for (int c = 0; c < TinyCapture::cameras; ++c) {
        const fs::path file = scene.capture.image(shut, c, "eye_mask");
        Image8 eyes = read_image8(file, 1);
        std::replace(eyes.values.begin(), eyes.values.end(), eye_mask_value(0), std::uint8_t(0));
        write_png(file, eyes);
    }
    scene.refine(scene.out, "2");
    const auto frames = read_json(scene.out / "refine.json").at("frames");
    const auto of = [&](int f) { return frames.at(TinyCapture::frame(f)); };
    CHECK(of(shut).at("closed").get<std::vector<bool>>() == std::vector<bool>{true, false});
    Vec2<double> mean = Vec2<double>::Zero();
    double count = 0;
    const auto change = [&](int f) {
        const auto c = of(f).at("change").at("gaze_left").get<std::vector<double>>();
        return Vec2<double>(c[0], c[1]);
    };
    for (const int f : before.train)
        if (f != shut && !of(f).at("outlier").get<bool>()) mean += change(f), ++count;
    REQUIRE(count >= 2);
    CHECK((change(shut) - mean / count).norm() < 1e-9);
    CHECK(of(shut).at("sigma").at("gaze_left").at(0).get<double>() == doctest::Approx(4));
}

TEST_CASE("refine: smaller pictures are of Gaussians as wide as training saw them") {
    const RefinedScene scene;
    const TrainState drawn = drawn_state(load_trained(scene.run));
    Capture capture = read_valid_capture(scene.capture.folder);
    const PlayableAvatar<float> avatar = refined_avatar(drawn, capture);
    const int block = 1 << avatar.avatar.upsampler.shape.doublings, size = TinyCapture::size;
    // Photographs are what the avatar draws.
    for (const int f : capture.train)
        for (int c = 0; c < TinyCapture::cameras; ++c) {
            HostLabelDrawing drawing(train_backend(), avatar.avatar, avatar.config, avatar.roles);
            drawing.drive(restricted<TrainedEffects>(frame_drivers(capture, f)));
            LabelView<float> view;
            view.camera = reduced(capture.camera(f, c).cast<float>(), block);
            const Columns<float>& colours = drawing.picture(view);
            Image8 rgb{size, size, 3, {}}, mask{size, size, 1, {}};
            for (int y = 0; y < size; ++y)
                for (int x = 0; x < size; ++x) {
                    mask.values.push_back(255);
                    for (int k = 0; k < 3; ++k)
                        rgb.values.push_back(static_cast<std::uint8_t>(std::lround(
                            255 * std::clamp(colours(k, y / block * view.camera.width + x / block),
                                             0.0F, 1.0F))));
                }
            write_png(scene.capture.image(f, c), rgb);
            write_png(scene.capture.image(f, c, "mask"), mask);
        }
    capture = read_valid_capture(scene.capture.folder);
    const auto residual = [&](int times) {
        RefineOptions options;
        options.size = size / (times * block);
        const RefinedCapture r =
            refine_capture(avatar, GazeAxis::optical, capture, capture.train, options);
        CHECK(r.block == times * block);
        double sum = 0;
        for (const RefinedFrame& f : r.frames) sum += 255 * f.found.first_residual;
        return sum / static_cast<double>(r.frames.size());
    };
    const double same = residual(1), half = residual(2), third = residual(3);
    MESSAGE("residuals at the labels [1/255]: ", same, "; of half the size ", half, ", a third ",
            third);
    CHECK(same < 7.5); // colours that photographs cannot have
    CHECK(half < 2 * same); // 4.7 and 9.4 times with a whole dilation
    CHECK(third < 3 * same);
}

TEST_CASE("refine: what it cannot do it says") {
    const RefinedScene scene;
    const std::string capture = scene.capture.folder.string(), out = scene.out.string();
    CHECK_FAULT(scene.command({"--capture", capture, "--out", capture}), "exists already");
    CHECK_FAULT(scene.command({"--capture", capture, "--out", out, "--no-gaze", "--no-pose",
                           "--expression", "none"}),
                "leave nothing to refine");
    CHECK(!fs::exists(scene.out));
}
