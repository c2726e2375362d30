// SPDX-License-Identifier: Apache-2.0
// `rye redirect` reads the frame and the cameras that it renders, and no others.
#include <doctest/doctest.h>

#include <algorithm>
#include <fstream>
#include <string>
#include <vector>

#include "../support/effect_sets.hpp"
#include "../support/file_bytes.hpp"
#include "command_line.hpp"
#include "commands/options.hpp"
#include "data/picture.hpp"
#include "data/run_frames.hpp"
#include "tiny_scene.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

struct DrawnScene : TinyScene {
    fs::path picture = folder.path / "picture.png";

    /// The bytes of the picture.
    std::string draw(const std::vector<std::string>& options) const {
        std::vector<std::string> words{"redirect", "--run", run.string(), "--threads", "1"};
        if (std::find(options.begin(), options.end(), "--out") == options.end())
            words.insert(words.end(), {"--out", picture.string()});
        words.insert(words.end(), options.begin(), options.end());
        fs::remove(picture);
        const Answer a = answer(words);
        if (a.code != 0) throw Error(a.text);
        return bytes_of(picture);
    }

    /// Makes a frame unreadable: removes arrays, damages images.
    void spoil_frame(int f) const {
        fs::remove_all(capture.folder / "params" / TinyCapture::frame(f));
        fs::remove_all(capture.folder / "cameras" / TinyCapture::frame(f));
        for (int c = 0; c < TinyCapture::cameras; ++c) spoil_pictures(f, c);
    }
    void spoil_pictures(int f, int c) const {
        for (const char* stem : {"image", "mask", "eye_mask"})
            std::ofstream(capture.image(f, c, stem), std::ios::trunc) << "no picture";
    }
    void spoil_other_frames(int kept) const {
        for (int f = 0; f < TinyCapture::frames; ++f)
            if (f != kept) spoil_frame(f);
    }
};

} // namespace

TEST_CASE("redirect: files of other frames are not read, and the picture has the same bytes") {
    const DrawnScene scene;
    const std::vector<std::vector<std::string>> calls{
        {"--frame", "0001"},
        {"--frame", "0001", "--camera", "c2", "--gaze-left", "5,10", "--gaze-right", "-5,-10"},
        {"--frame", "0001", "--gaze-at", "head:0.2,0.4,6"},
        {"--frame", "0001", "--effects", "gaze"},
        {"--frame", "0001", "--compare"},
        {"--frame", "0001", "--sweep"}};
    std::vector<std::string> before;
    for (const std::vector<std::string>& options : calls) before.push_back(scene.draw(options));
    const Image8 drawn = (scene.draw(calls[0]), read_image8(scene.picture, 3));
    CHECK(*std::min_element(drawn.values.begin(), drawn.values.end()) <
          *std::max_element(drawn.values.begin(), drawn.values.end()));
    CHECK(before[0] != before[1]);
    CHECK(before[0] != scene.draw({"--frame", "0002"}));

    scene.spoil_other_frames(1);
    for (std::size_t k = 0; k < calls.size(); ++k) {
        CAPTURE(k);
        CHECK(scene.draw(calls[k]) == before[k]);
    }
    CHECK_FAULT(scene.draw({"--frame", "0002"}), "0002");
    CHECK_FAULT(scene.draw({}), "0003");  // the first test frame
}

TEST_CASE("redirect: the first test frame is drawn without the others") {
    const DrawnScene scene;
    const std::string before = scene.draw({});
    CHECK(before == scene.draw({"--frame", "0003"}));
    scene.spoil_other_frames(3);
    CHECK(scene.draw({}) == before);
}

TEST_CASE("redirect: with a camera that is named, files of other cameras are not read") {
    const DrawnScene scene;
    const std::vector<std::string> c1{"--frame", "0002", "--camera", "c1"};
    const std::string before = scene.draw(c1);
    for (const int c : {0, 2}) {
        scene.spoil_pictures(2, c);
        fs::remove(scene.capture.camera_file(2, c));
    }
    CHECK(scene.draw(c1) == before);
    CHECK_FAULT(scene.draw({"--frame", "0002", "--camera", "c0"}), "c0");
    CHECK_FAULT(scene.draw({"--frame", "0002"}), "c0");
}

TEST_CASE("redirect: frames of a capture.json need not be there, but for the one that is drawn") {
    const DrawnScene scene;
    scene.capture.write_text("capture.json",
                             R"({"train_frames": ["0000", "0001"], "test_frames": ["0003", "0002"],
                                 "camera_ids": ["c0", "c1", "c2"], "image_size": [48, 48]})");
    const std::string before = scene.draw({});
    for (const int f : {0, 1, 2}) {
        scene.spoil_frame(f);
        fs::remove_all(scene.capture.folder / "images" / TinyCapture::frame(f));
    }
    CHECK(scene.draw({}) == before);
    CHECK_FAULT(scene.draw({"--frame", "0001"}), "capture.json names the frame");
}

TEST_CASE("redirect: what is wrong with the frame that is drawn is still told") {
    const DrawnScene scene;
    CHECK_FAULT(scene.draw({"--frame", "9"}),
                "--frame: got '9', expected one from '0000' to '0003'");
    CHECK_FAULT(scene.draw({"--camera", "c9"}), "--camera: got 'c9', expected one of: c0 c1 c2");
    const fs::path params = scene.capture.params(1, "params.npz");
    const std::string kept = bytes_of(params);
    TinyCapture::edit_one(params, "exp_coeff", [](std::vector<double>& w) { w[1] = 1e6; });
    CHECK_FAULT(scene.draw({"--frame", "0001"}), "exp_coeff");
    std::ofstream(params, std::ios::binary | std::ios::trunc) << kept;
    TinyCapture::edit_one(scene.capture.params(1, "lmk_3d.npy"), "",
                          [](std::vector<double>& x) { for (double& v : x) v *= 100; });
    CHECK_FAULT(scene.draw({"--frame", "0001"}), "millimetres");
    for (const char* stem : {"image", "mask"}) fs::remove(scene.capture.image(0, 2, stem));
    fs::remove(scene.capture.camera_file(0, 2));
    CHECK_FAULT(scene.draw({"--frame", "0000", "--camera", "c2"}),
                "camera 'c2' has no image of frame '0000'");
    CHECK_FAULT(scene.draw({"--frame", "0003", "--gaze-left", "80,0"}), "at most 70");
}

TEST_CASE("redirect: labels of a picture, and of a video of a head that lives") {
    const DrawnScene scene;
    const std::string file = (scene.folder.path / "labels.jsonl").string();
    const auto lines = [&] {
        const std::string text = bytes_of(file);
        return std::count(text.begin(), text.end(), '\n');
    };
    scene.draw({"--gaze-at", "head:0,0,6", "--labels", file});
    CHECK(lines() == 1);
    CHECK(bytes_of(file).find(R"("picture":"picture.png")") != std::string::npos);
    const std::string video = (scene.folder.path / "live").string();
    scene.draw({"--out", video, "--idle", "0.2", "--seed", "3", "--labels", file});
    CHECK(lines() == 5);
    CHECK(bytes_of(file).find(R"("picture":"frame_0004.png")") != std::string::npos);
    CHECK(fs::exists(fs::path(video) / "frame_0004.png"));
    const fs::path moving = scene.folder.path / "live.y4m";
    const auto seeded = [&](const char* seed) {
        scene.draw({"--out", moving.string(), "--idle", "0.2", "--seed", seed});
        return bytes_of(moving);
    };
    const std::string first = seeded("3");
    CHECK(seeded("3") == first);
    CHECK(seeded("4") != first);
}

TEST_CASE("redirect: pupils are drawn by an option or a table; eyes without irises say so") {
    const DrawnScene scene;
    CHECK_FAULT(scene.draw({"--pupil", "1.5"}), "eye have no iris apart from a sphere");
    TrainState state = load_checkpoint(scene.run);
    test::set_tiny_irises(state.avatar.eyes);
    save_checkpoint(scene.run, state);
    const std::string rest = scene.draw({}), wide = scene.draw({"--pupil", "1.6"});
    CHECK(scene.draw({"--pupil", "1"}) == rest);
    CHECK(wide != rest);
    CHECK(scene.draw({"--pupil", "1.6,1.6"}) == wide);
    CHECK(scene.draw({"--pupil", "1.6,1"}) != wide);
    CHECK_FAULT(scene.draw({"--pupil", "1,0.3"}), "--pupil: got 0.3, expected 0.4 to 2");
    const fs::path table = scene.folder.path / "pupils.csv", video = scene.folder.path / "p.y4m";
    const auto driven = [&](const std::string& rows, const std::string& option) {
        std::ofstream(table, std::ios::trunc) << "pupil_right\n" << rows;
        std::vector<std::string> words{"--driving", table.string(), "--out", video.string()};
        if (!option.empty()) words.insert(words.end(), {"--pupil", option});
        scene.draw(words);
        return bytes_of(video);
    };
    const std::string moves = driven("1\n1.6\n", "");
    CHECK(moves != driven("1\n1\n", ""));
    CHECK(moves != driven("1.6\n1\n", ""));
    CHECK(driven("1\n1.6\n", "1") == driven("1\n1\n", ""));
}

TEST_CASE("redirect: Gaussians are as wide on the head by cameras of one's own") {
    const DrawnScene scene;
    const Capture capture = read_capture(scene.capture.folder);
    const TrainState state = load_trained(scene.run);
    const ShownView view = shown_view(scene.run, state, scene.capture.folder, "", "");
    const Pinhole<float> usual = capture.camera(view.frame, view.camera).cast<float>();
    const Drivers<float> drivers = frame_drivers(capture, view.frame, state.config.gaze_axis);
    std::vector<DrawnFrame> frames{{drivers, usual}, {drivers, scaled(usual, 2)}};
    take_size(scene.run, state, view, frames);
    CHECK(frames[0].dilation == trained_dilation);
    CHECK(frames[1].dilation == doctest::Approx(4 * trained_dilation));
    const std::string size = std::to_string(usual.width) + "x" + std::to_string(usual.height);
    CHECK(scene.draw({"--size", size}) == scene.draw({}));
    // A capture of pictures of half the trained size.
    save_frames(scene.run, capture);
    Capture half = read_capture(scene.capture.folder);
    half.height /= 2;
    CHECK(dilation_of(scene.run, state, half) == doctest::Approx(trained_dilation / 4));
    CHECK(dilation_of(scene.run, state, capture) == trained_dilation);
}

TEST_CASE("redirect: an older run is drawn by its capture, and asks for it when it is gone") {
    const DrawnScene scene;
    const std::string before = scene.draw({});
    const fs::path away = scene.folder.path / "away";
    fs::rename(scene.capture.folder, away);
    CHECK_FAULT(scene.draw({}), "holds no frames.safetensors");
    CHECK_FAULT(scene.draw({}), "--capture");
    CHECK(scene.draw({"--capture", away.string()}) == before);
    CHECK_FAULT(scene.draw({"--compare"}), "--capture");
    // With its frames beside it, it needs no capture.
    save_frames(scene.run, read_capture(away));
    fs::remove_all(away);
    CHECK(scene.draw({}) == before);
}
