// SPDX-License-Identifier: Apache-2.0
#include "evaluation/closed_lids.hpp"
#include "evaluation/evaluation.hpp"

#include <unistd.h>

#include <doctest/doctest.h>

#include <rye/train/lid_margin.hpp>

#include "../programs/tiny_capture.hpp"
#include "../programs/tiny_run.hpp"
#include "data/picture.hpp"
#include "data/threads.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

constexpr double degree = 3.14159265358979323846 / 180;

std::optional<GazeEstimate> looking(double yaw_deg) {
    return GazeEstimate{gaze_vector(0.0, yaw_deg * degree), 1, 100};
}

struct Folder {
    fs::path path = fs::temp_directory_path() / ("rye_evaluate_" + std::to_string(::getpid()));
    Folder() { fs::remove_all(path); }
    ~Folder() { fs::remove_all(path); }
};

/// The eye mask of one view with discs of this radius [px] around both eyeballs.
void draw_eyes(const TinyCapture& files, int frame, int camera, double radius) {
    constexpr int size = TinyCapture::size;
    Image8 mask{size, size, 1, std::vector<std::uint8_t>(size * size, 0)};
    for (int e = 0; e < 2; ++e) {
        const Vec3<double> centre(e == 0 ? 0.32 : -0.32, 0.33, 0.8);
        const Vec2<double> at =
            TinyCapture::pinhole(camera).project_point(TinyCapture::to_world(frame, centre)).head<2>();
        for (int y = 0; y < size; ++y)
            for (int x = 0; x < size; ++x)
                if ((Vec2<double>(x + 0.5, y + 0.5) - at).norm() < radius)
                    mask.values[static_cast<std::size_t>(y * size + x)] = e == 0 ? 85 : 170;
    }
    write_png(files.image(frame, camera, "eye_mask"), mask);
}

} // namespace

TEST_CASE("gaze errors: by hand, an eye without an iris on either picture counts 90 degrees") {
    GazeErrors errors;
    const Vec3<double> label = gaze_vector(0.0, 4 * degree);
    errors.add(looking(10), looking(0), label);       // 10 off the photograph, 6 off the label
    errors.add(std::nullopt, looking(0), label);      // not found on the render
    errors.add(looking(-10), std::nullopt, label);    // not found on the photograph: 14 off the label
    errors.add(std::nullopt, std::nullopt, label);
    CHECK(errors.to_photograph.count == 4);
    CHECK(errors.to_photograph.value() == doctest::Approx((10 + 90 + 90 + 90) / 4.0));
    CHECK(errors.to_label.value() == doctest::Approx((6 + 90 + 14 + 90) / 4.0));
    CHECK(errors.to_label_where_found.count == 2);
    CHECK(errors.to_label_where_found.value() == doctest::Approx((6 + 14) / 2.0));
    CHECK(errors.where_found.count == 1);
    CHECK(errors.where_found.value() == doctest::Approx(10));
    CHECK(errors.found == 2);
    GazeErrors twice = errors;
    twice.add(errors);
    CHECK(twice.to_photograph.count == 8);
    CHECK(twice.found == 4);
    CHECK(twice.to_label_where_found.count == 4);
    CHECK(twice.to_photograph.value() == doctest::Approx(errors.to_photograph.value()));
    CHECK(GazeErrors{}.json()["degrees"].is_null());
}

TEST_CASE("evaluation: each visible eye counts, and no other, whatever the run shows") {
    const Folder folder;
    const TinyCapture files(folder.path);
    // Photographs of a grey disc, without any iris. Some of the eyes have enough pixels.
    draw_eyes(files, 0, 0, 5);
    draw_eyes(files, 0, 1, 1.5);
    for (int f = 0; f < TinyCapture::frames; ++f)
        TinyCapture::set(files.params(f, "params.npz"), "exp_coeff", {1, 3},
                         std::vector<float>{0.1f, 0.2f, 0.3f});
    const Capture capture = read_capture(folder.path);
    const TrainState run = drawn_state(tiny_state());
    const Evaluation evaluation(run, capture);
    Image<float> picture;
    const ViewResult large = evaluation.view(0, 0, picture);
    CHECK(large.eyes_in_view == 2);
    CHECK(large.eyes_visible == 2);
    for (const GazeTable* t : {&large.measured, &large.own})
        for (const GazeErrors* e : {&t->render, &t->rest, &t->nearest}) {
            CHECK(e->to_photograph.count == 2);
            CHECK(e->to_photograph.value() == missed_degrees);
            CHECK(e->where_found.count == 0);
        }
    CHECK(large.measured.photograph.found == 0);
    CHECK(large.measured.photograph.to_label.value() == missed_degrees);
    const ViewResult small = evaluation.view(0, 1, picture);
    CHECK(small.eyes_in_view == 2);
    CHECK(small.eyes_visible == 0);
    CHECK(small.measured.render.to_photograph.count == 0);
}

TEST_CASE("evaluation: crops around the eyes count the skin alone, whatever the eyeballs show") {
    const Folder folder;
    const TinyCapture files(folder.path);
    draw_eyes(files, 0, 0, 5);
    for (int f = 0; f < TinyCapture::frames; ++f)
        TinyCapture::set(files.params(f, "params.npz"), "exp_coeff", {1, 3},
                         std::vector<float>{0.1f, 0.2f, 0.3f});
    const Image<float> mask = read_capture(folder.path).eye_mask(0, 0);
    const Image8 photograph = read_image8(files.image(0, 0), 3);
    const auto measured = [&](bool eyes, bool skin) { // after a change of photograph
        Image8 changed = photograph;
        for (int y = 0; y < mask.height; ++y)
            for (int x = 0; x < mask.width; ++x) {
                const bool eye = std::max(mask.at(x, y)(0), mask.at(x, y)(1)) >= 0.5f;
                if (eye ? eyes : skin)
                    for (int c = 0; c < 3; ++c) {
                        std::uint8_t& v =
                            changed.values[static_cast<std::size_t>(3 * (y * mask.width + x) + c)];
                        v = static_cast<std::uint8_t>(v < 128 ? v + 90 : v - 90);
                    }
            }
        write_png(files.image(0, 0), changed);
        const Capture capture = read_capture(folder.path);
        const TrainState run = drawn_state(tiny_state());
        Image<float> picture;
        return Evaluation(run, capture).view(0, 0, picture);
    };
    const ViewResult before = measured(false, false), eyes = measured(true, false),
                     skin = measured(false, true);
    REQUIRE(before.eye_skin.psnr.count == 1);
    // Two discs of 10 pixels, and 3 pixels more on each side.
    CHECK(before.eyes_box[2] > 16);
    CHECK(before.eyes_box[3] >= 10);
    CHECK(before.eyes_box[1] + before.eyes_box[3] <= TinyCapture::size);
    CHECK(eyes.eye_skin.psnr.value() == before.eye_skin.psnr.value());
    CHECK(eyes.eye_skin.ssim.value() == before.eye_skin.ssim.value());
    CHECK(eyes.eyes.psnr.value() != before.eyes.psnr.value());
    CHECK(skin.eye_skin.psnr.value() != before.eye_skin.psnr.value());
    CHECK(before.json()["eyes_painted_white"]["psnr"] == before.eye_skin.psnr.value());
}

TEST_CASE("evaluation: lids' margins are the pixels beside the lids' lines of visible eyes") {
    const Folder folder;
    const TinyCapture files(folder.path);
    draw_eyes(files, 0, 0, 5);
    for (int f = 0; f < TinyCapture::frames; ++f)
        TinyCapture::set(files.params(f, "params.npz"), "exp_coeff", {1, 3},
                         std::vector<float>{0.1f, 0.2f, 0.3f});
    const Capture labels = read_capture(folder.path);
    const Pinhole<double> view = labels.camera(0, 0);
    // Distance of a pixel's middle from both eyes' lines, over the margins' half width.
    const auto distance = [&](int x, int y) {
        double least = 1e9;
        for (int eye = 0; eye < 2; ++eye) {
            const CaptureFrame& frame = labels.frames[0];
            const LidLines<double> lids = lid_lines<double>(frame.landmarks, eye, 1e-4);
            for (const Columns<double>* line : {&lids.upper, &lids.lower})
                for (Index k = 0; k < line->cols(); ++k) {
                    const Vec3<double> at = view.project_point(line->col(k));
                    const double half = 0.01 * lid_margin_mm * frame.scale * view.fx / at.z();
                    least = std::min(least,
                                     (Vec2<double>(x + 0.5, y + 0.5) - at.head<2>()).norm() / half);
                }
        }
        return least;
    };
    const Image8 photograph = read_image8(files.image(0, 0), 3);
    int inside = 0;
    const auto measured = [&](bool margins, bool others) { // after a change of photograph
        Image8 changed = photograph;
        inside = 0;
        for (int y = 0; y < TinyCapture::size; ++y)
            for (int x = 0; x < TinyCapture::size; ++x) {
                const double away = distance(x, y);
                inside += away < 0.9 ? 1 : 0;
                if (!(margins && away < 0.9) && !(others && away > 1.1)) continue;
                for (int c = 0; c < 3; ++c) {
                    std::uint8_t& v =
                        changed
                            .values[static_cast<std::size_t>(3 * (y * TinyCapture::size + x) + c)];
                    v = static_cast<std::uint8_t>(v < 128 ? v + 90 : v - 90);
                }
            }
        write_png(files.image(0, 0), changed);
        const Capture capture = read_capture(folder.path);
        const TrainState run = drawn_state(tiny_state());
        Image<float> picture;
        return Evaluation(run, capture).view(0, 0, picture);
    };
    const ViewResult before = measured(false, false), margins = measured(true, false),
                     others = measured(false, true);
    CHECK(inside > 3);
    REQUIRE(before.lid_margins.psnr.count == 1);
    CHECK(others.lid_margins.psnr.value() == before.lid_margins.psnr.value());
    CHECK(others.eyes.psnr.value() != before.eyes.psnr.value());
    CHECK(margins.lid_margins.psnr.value() != before.lid_margins.psnr.value());
    CHECK(before.json()["lid_margins"]["psnr"] == before.lid_margins.psnr.value());
    draw_eyes(files, 0, 0, 0); // no visible eye
    CHECK(measured(false, false).lid_margins.psnr.count == 0);
}

TEST_CASE("evaluation: LPIPS of what is white outside the head, where a distance is given") {
    const Folder folder;
    const TinyCapture files(folder.path);
    for (int f = 0; f < TinyCapture::frames; ++f)
        TinyCapture::set(files.params(f, "params.npz"), "exp_coeff", {1, 3},
                         std::vector<float>{0.1f, 0.2f, 0.3f});
    const Capture capture = read_capture(folder.path);
    const TrainState run = drawn_state(tiny_state());
    Image<float> picture;
    CHECK(Evaluation(run, capture).view(0, 0, picture).json()["lpips"].is_null());
    int asked = 0;
    const Columns<float> head = capture.mask(0, 0).pixels;
    const Evaluation evaluation(run, capture, [&](const Image<float>& a, const Image<float>& b) {
        ++asked;
        for (Index p = 0; p < a.size(); ++p)
            if (head(0, p) < 0.5f) {
                CHECK(a.pixels.col(p) == Vec3<float>(1, 1, 1));
                CHECK(b.pixels.col(p) == Vec3<float>(1, 1, 1));
            }
        return 0.25;
    });
    CHECK(evaluation.view(0, 0, picture).json()["lpips"] == 0.25);
    CHECK(asked == 1);
    CHECK(!lpips_of({}));
}

TEST_CASE("evaluation: views at once have the results of one after the other, for any threads") {
    const Folder folder;
    const TinyCapture files(folder.path);
    for (int f = 0; f < TinyCapture::frames; ++f)
        for (int c = 0; c < 2; ++c) draw_eyes(files, f, c, 5);
    for (int f = 0; f < TinyCapture::frames; ++f)
        TinyCapture::set(files.params(f, "params.npz"), "exp_coeff", {1, 3},
                         std::vector<float>{0.1f, 0.2f * static_cast<float>(f), 0.3f});
    const Capture capture = read_capture(folder.path);
    const TrainState run = drawn_state(tiny_state());
    const Evaluation evaluation(run, capture, [](const Image<float>& a, const Image<float>& b) {
        return static_cast<double>((a.pixels - b.pixels).cwiseAbs().sum());
    });
    // More than are held at once by one thread.
    std::vector<MeasuredView> which;
    for (int k = 0; k < 11; ++k) which.push_back({k % TinyCapture::frames, k % 2, k % 3 == 0});
    const auto all = [&](int threads, std::vector<Image<float>>& pictures) {
        set_threads(threads);
        pictures.assign(which.size(), {});
        nlohmann::ordered_json json;
        for (const ViewResult& r :
             evaluation.views(which, [&](std::size_t i, const Image<float>& p) { pictures[i] = p; }))
            json.push_back(r.json());
        return json;
    };
    std::vector<Image<float>> one, three;
    const nlohmann::ordered_json alone = all(1, one);
    CHECK(alone.dump() == all(3, three).dump());
    for (std::size_t i = 0; i < which.size(); ++i) {
        Image<float> picture;
        CHECK(alone[i] == evaluation.view(which[i].frame, which[i].camera, picture).json());
        CHECK(one[i].pixels == three[i].pixels);
        CHECK((one[i].size() > 0) == which[i].pictured);
        if (which[i].pictured) CHECK(one[i].pixels == picture.pixels);
    }
    CHECK(alone[0] != alone[1]);
    set_threads(0);
}

TEST_CASE("evaluation: the geometry is the capture's in one row, the rig's in the other") {
    const Folder folder;
    const TinyCapture files(folder.path);
    const Capture capture = read_capture(folder.path);
    TrainState run = drawn_state(tiny_state());
    run.avatar.eyes.offset.mlp.weight.back().setZero();
    run.avatar.eyes.offset.mlp.bias.back().setZero();
    const Evaluation evaluation(run, capture);
    const EyesOfView measured = evaluation.measured_eyes(1, 0);
    CHECK((measured.ball[0].centre - *capture.frames[1].eyes[0].centre).norm() == 0);
    CHECK(measured.ball[0].radius == *capture.frames[1].eyes[0].radius);
    CHECK(measured.ball[1].limbus_radius == *capture.frames[1].eyes[1].limbus_radius);

    Drivers<float> drivers = test::tiny_drivers<float>();
    const EyesOfView own = evaluation.own_eyes(drivers, capture.camera(1, 0));
    const auto scale = static_cast<double>(drivers.scale);
    CHECK(own.ball[0].radius == run.subject.eye_radius[0] * scale);
    CHECK(own.ball[1].limbus_radius == run.subject.limbus_radius[1] * scale);
    CHECK(own.ball[1].iris_plane == run.subject.iris_plane[1] * scale);
    CHECK(own.area_error == own_area_error);
    CHECK(measured.area_error == 0);
    const std::optional<double>& plane = capture.frames[1].eyes[0].iris_plane;
    CHECK(measured.ball[0].iris_plane ==
          plane.value_or(run.subject.iris_plane[0] * capture.frames[1].scale));
    const Mat3<double> turn = so3_exp(Vec3<double>(drivers.pose.head<3>().cast<double>()));
    for (std::size_t e = 0; e < 2; ++e) {
        const Vec3<double> centre = run.avatar.eyes.centre.col(static_cast<Index>(e)).cast<double>();
        const Vec3<double> posed =
            scale * (turn * centre) + drivers.pose.tail<3>().cast<double>();
        CHECK((own.ball[e].centre - posed).norm() <= 1e-6);
        CHECK((own.ball[e].head_rotation - turn).norm() <= 1e-12);
    }
}

TEST_CASE("closed lids: pixels of the eyes with the lids' coefficients at 0 and at 1, by their names") {
    const Folder folder;
    const TinyCapture files(folder.path);
    for (int f = 0; f < TinyCapture::frames; ++f)
        TinyCapture::set(files.params(f, "params.npz"), "exp_coeff", {1, 3},
                         std::vector<float>{0.1f, 0.2f, 0.3f});
    Capture capture = read_capture(folder.path);
    const TrainState run = drawn_state(tiny_state());
    const std::vector<MeasuredView> views{{0, 0, true}, {1, 1, false}, {1, 0, true}};
    capture.expression_names = {"jawOpen", "eyeBlink_L", "Eyes-Closed"};
    const ClosedLids lids = closed_lids(run, capture, views);
    CHECK(lids.names == std::vector<std::string>{"eyeBlink_L", "Eyes-Closed"});
    CHECK(lids.pictures == 2);
    const auto by_hand = [&](float weight) {
        double sum = 0;
        for (const int frame : {0, 1}) {
            Drivers<float> drivers = frame_drivers(capture, frame, run.config.gaze_axis);
            drivers.expression[1] = drivers.expression[2] = weight;
            const Evaluation evaluation(run, capture);
            sum += static_cast<double>(
                evaluation.own_eyes(drivers, capture.camera(frame, 0)).area.pixels.sum());
        }
        return sum;
    };
    CHECK(lids.open == doctest::Approx(by_hand(0)));
    CHECK(lids.closed == doctest::Approx(by_hand(1)));
    CHECK(lids.open > 1);
    CHECK(lids.closed != lids.open);
    CHECK(lids.json()["visible"] == lids.closed / lids.open);

    capture.expression_names = {"jawOpen", "browDown_L", "browDown_R"};
    CHECK(closed_lids(run, capture, views).json().is_null());
    capture.expression_names.clear();
    CHECK(closed_lids(run, capture, views).json().is_null());
}
