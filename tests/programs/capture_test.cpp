// SPDX-License-Identifier: Apache-2.0
// With RYE_DATA set to a folder that holds capture_a, that capture is read as well.
#include "../support/real_data.hpp"
#include "data/capture.hpp"

#include <filesystem>
#include <fstream>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <doctest/doctest.h>

#include <rye/io/png.hpp>
#include <rye/io/read_capture.hpp>

#include "../support/hostile.hpp"
#include "data/picture.hpp"
#include "tiny_capture.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

TEST_CASE("capture: what the files hold") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    const Capture c = read_capture(folder.path);
    CHECK(c.frame_count() == 4);
    CHECK(c.camera_ids == std::vector<std::string>{"c0", "c1", "c2"});
    CHECK(c.expression_width() == 2);
    CHECK(c.width == 48);
    CHECK(c.height == 48);
    CHECK(c.has_gaze());
    CHECK(c.has_centres());
    CHECK(c.has_eye_masks);
    CHECK(c.train == std::vector<int>{0, 1, 2}); // the last fifth, at least one, is for tests
    CHECK(c.test == std::vector<int>{3});
    const CaptureFrame& f = c.frames[2];
    CHECK(f.id == "0002");
    CHECK(f.pose == TinyCapture::pose(2));
    CHECK(f.scale == 1.0);
    CHECK(f.vertices.cols() == 5);
    CHECK(f.expression == std::vector<float>{0.2f, 0.5f});
    CHECK((*f.eyes[0].kappa)[0] == 5.0);
    CHECK(*f.eyes[1].radius == 0.15);
    const Pinhole<double> expected = TinyCapture::pinhole(2);
    CHECK(c.camera(1, 2).fx == expected.fx);
    // Not ==: a compiler may fuse the products of the two ways to the same camera differently.
    CHECK(c.camera(1, 2).camera_from_world.rotation.isApprox(expected.camera_from_world.rotation,
                                                             1e-14));
    CHECK(c.camera(1, 2).camera_from_world.translation.isApprox(
        expected.camera_from_world.translation, 1e-14));
    CHECK(c.camera(1, 2).width == 48);
}

TEST_CASE("capture: 68 landmarks lose the inner lip corners 48 and 54; eyes keep their places") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    const Capture c = read_capture(folder.path);
    const Columns<double> head = TinyCapture::head_points();
    REQUIRE(c.frames[1].landmarks.cols() == 66);
    for (int i = 0, kept = 0; i < 68; ++i) {
        if (i == 48 || i == 54) continue;
        const Vec3<double> expected = TinyCapture::to_world(1, head.col(i));
        CHECK((c.frames[1].landmarks.col(kept++) - expected).norm() < 1e-6);
    }
    for (const int eye : {0, 1})
        for (const int k : eye_landmarks(eye))
            CHECK((c.frames[0].landmarks(0, k) > 0) == (eye == 0));
    // 66 landmarks are taken as they are.
    write_npy(tiny.params(1, "lmk_3d.npy"), npy_array<double>(c.frames[1].landmarks));
    CHECK(read_capture(folder.path).frames[1].landmarks == c.frames[1].landmarks);
}

TEST_CASE("capture: pixels, masks and labels") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    const Capture c = read_capture(folder.path);
    const Image<float> image = c.image(2, 1), mask = c.mask(2, 1), eyes = c.eye_mask(2, 1);
    CHECK(image.channels() == 3);
    CHECK(mask.channels() == 1);
    CHECK(eyes.channels() == 2);
    CHECK(image.at(24, 24) == Vec3<float>(121 / 255.0f, 122 / 255.0f, 123 / 255.0f));
    CHECK(mask.at(24, 24)[0] == 1.0f);
    CHECK(mask.at(0, 0)[0] == 0.0f);
    CHECK(eyes.pixels.row(0).sum() >= 5);
    CHECK(eyes.pixels.row(1).sum() >= 5);
    CHECK(eyes.pixels.colwise().sum().maxCoeff() == 1.0f);
    // In front of the face the subject's left eye is on the image's right.
    double left = 0, right = 0;
    for (int y = 0; y < 48; ++y)
        for (int x = 0; x < 48; ++x) {
            left += double(x) * eyes.at(x, y)[0] / eyes.pixels.row(0).sum();
            right += double(x) * eyes.at(x, y)[1] / eyes.pixels.row(1).sum();
        }
    CHECK(left > right + 5);
    CHECK(c.visible(2, 1).pixels.minCoeff() == 1.0f);

    Image8 padded{48, 48, 1, std::vector<std::uint8_t>(48 * 48, 255)};
    padded.values[5] = 0;
    write_png(tiny.image(2, 1, "visible"), padded);
    const Capture again = read_capture(folder.path);
    CHECK(again.visible(2, 1).pixels(0, 5) == 0.0f);
    CHECK(again.visible(2, 0).pixels(0, 5) == 1.0f);
}

TEST_CASE("capture: a photograph is multiplied by its mask, a premultiplied image is not") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    Image8 half{48, 48, 1, std::vector<std::uint8_t>(48 * 48, 51)};
    write_png(tiny.image(0, 0, "mask"), half);
    const auto red = [&](ImageContent content) {
        CaptureOptions options;
        options.content = content;
        return read_capture(folder.path, options).image(0, 0).at(24, 24)[0];
    };
    CHECK(red(ImageContent::photograph) == 100 / 255.0f * (51 / 255.0f));
    CHECK(red(ImageContent::over_black) == 100 / 255.0f);
    CHECK(red(ImageContent::automatic) == red(ImageContent::photograph));
    tiny.write_text("capture.json", R"({"conventions": {"image": "8-bit sRGB over black"}})");
    CHECK(red(ImageContent::automatic) == red(ImageContent::over_black));
}

TEST_CASE("capture: the cache keeps its budget, and a moved capture keeps its cache") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    const std::size_t budget = 48 * 48 * 8; // two colour images, or one and more masks
    Capture first = rye::read_capture(folder.path, ImageCache(budget));
    for (int round = 0; round < 2; ++round)
        for (int f = 0; f < 4; ++f)
            for (int k = 0; k < 3; ++k) {
                const auto expected = static_cast<float>(100 + 10 * f + k) / 255.0f;
                CHECK(first.image(f, k).at(24, 24)[0] == expected);
                CHECK(first.pictures.bytes() <= budget);
            }
    const Capture c = std::move(first);
    CHECK(c.pictures.bytes() > 0);
    fs::remove(tiny.image(3, 2));
    CHECK(c.image(3, 2).at(24, 24)[0] == 132 / 255.0f); // still held
    CHECK(c.image(0, 0).at(24, 24)[0] == 100 / 255.0f);
}

TEST_CASE("capture: several threads may read one whose cache is too small for them") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    const Capture c = rye::read_capture(folder.path, ImageCache(48 * 48 * 4));
    std::vector<std::string> wrong(8);
    std::vector<std::thread> threads;
    for (std::size_t t = 0; t < wrong.size(); ++t)
        threads.emplace_back([&, t] {
            for (std::size_t n = 0; n < 200; ++n) {
                const int view = static_cast<int>((n * (t + 1) + t) % 12), f = view / 3, k = view % 3;
                const auto expected = static_cast<float>(100 + 10 * f + k) / 255.0f;
                if (c.image(f, k).at(24, 24)[0] != expected)
                    wrong[t] += " " + std::to_string(view);
                if (c.mask(f, k).width != 48) wrong[t] += " mask";
            }
        });
    for (std::thread& t : threads) t.join();
    for (const std::string& w : wrong) CHECK(w == "");
    CHECK(c.pictures.bytes() <= 48 * 48 * 4);
    // One that cannot be read is an error for each that reads it, and others go on.
    const Capture broken = rye::read_capture(folder.path, ImageCache());
    std::ofstream(tiny.image(2, 1)) << "none";
    for (int round = 0; round < 2; ++round)
        CHECK_THROWS_AS(static_cast<void>(broken.image(2, 1)), Error);
    CHECK(broken.image(2, 0).at(24, 24)[0] == 120 / 255.0f);
}

TEST_CASE("capture: the headers alone read the same pixels") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    const Capture ours = read_capture(folder.path);
    const auto theirs = rye::read_capture(folder.path, PngFiles{});
    CHECK(theirs.camera_ids == ours.camera_ids);
    CHECK(theirs.width == 48);
    for (int f = 0; f < 4; ++f)
        for (int k = 0; k < 3; ++k) {
            CHECK(theirs.image(f, k).pixels == ours.image(f, k).pixels);
            CHECK(theirs.mask(f, k).pixels == ours.mask(f, k).pixels);
            CHECK(theirs.eye_mask(f, k).pixels == ours.eye_mask(f, k).pixels);
        }
    fs::rename(tiny.image(0, 0), folder.path / "images/0000/image_c0.jpg");
    CHECK_NOTHROW(rye::read_capture(folder.path, PngFiles{})); // by its content
    std::ofstream(folder.path / "images/0000/image_c0.jpg") << "\xff\xd8\xff";
    CHECK_FAULT(rye::read_capture(folder.path, PngFiles{}), "image_c0.jpg: not a PNG");
}

TEST_CASE("capture: a capture.json that begins with a mark of UTF-8, or is not UTF-8") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    tiny.write_text("capture.json", "\xEF\xBB\xBF{\"subject\": \"t\"}");
    CHECK(read_capture(folder.path).subject == "t");
    tiny.write_text("capture.json", "{\"subject\": \"\xFF\"}");
    CHECK_FAULT(read_capture(folder.path),
                "capture.json: its byte 13 begins no character of UTF-8");
}

TEST_CASE("capture: splits from capture.json") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    tiny.write_text("capture.json", R"({"subject": "t", "image_size": [48, 48],
        "camera_ids": ["c2", "c0"], "exp_names": ["a", "b"],
        "train_frames": ["0001", "0003"], "test_frames": ["0000", "0002"],
        "novel_gaze_test_frames": ["0002"], "independent_gaze_test_frames": []})");
    const Capture c = read_capture(folder.path);
    CHECK(c.subject == "t");
    CHECK(c.camera_ids == std::vector<std::string>{"c2", "c0"});
    CHECK(c.camera(0, 0).camera_from_world.rotation.isApprox(
        TinyCapture::pinhole(2).camera_from_world.rotation, 1e-14));
    CHECK(c.train == std::vector<int>{1, 3});
    CHECK(c.test == std::vector<int>{0, 2});
    CHECK(c.novel_gaze == std::vector<int>{2});
    CHECK(c.independent_gaze.empty());
    CHECK(c.expression_names == std::vector<std::string>{"a", "b"});
}

TEST_CASE("capture: without gaze, vertices, scale and eye masks it is read, and says so") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    for (int f = 0; f < 4; ++f) {
        fs::remove(tiny.params(f, "vertices.npy"));
        TinyCapture::remove(tiny.params(f, "params.npz"), "scale");
    }
    fs::remove(tiny.params(2, "gaze.npz"));
    fs::remove(tiny.image(0, 0, "eye_mask"));
    const Capture c = read_capture(folder.path);
    CHECK(!c.has_gaze());
    CHECK(c.frames[0].has_gaze);
    CHECK(!c.has_eye_masks);
    CHECK(c.eye_mask(0, 0).pixels.maxCoeff() == 0.0f);
    CHECK(c.eye_mask(0, 1).pixels.maxCoeff() == 1.0f);
    CHECK(c.frames[0].vertices.cols() == 0);
    CHECK(c.frames[0].scale == 1.0);
}

TEST_CASE("capture: a camera may miss a frame") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    for (const char* stem : {"image", "mask", "eye_mask"}) fs::remove(tiny.image(1, 2, stem));
    fs::remove(tiny.camera_file(1, 2));
    std::vector<Problem> problems;
    const Capture c = read_capture(folder.path, {}, &problems);
    REQUIRE(problems.size() == 1);
    CHECK(problems[0].severity == Problem::Severity::warning);
    CHECK(!c.view(1, 2).present);
    CHECK(c.view(1, 1).present);
    CHECK_FAULT(c.image(1, 2), "camera c2 has no frame 0001");
}

TEST_CASE("capture: the real capture") {
    const auto folder = test::real_data("capture_a");
    if (!folder) return;
    const Capture c = read_capture(*folder);
    CHECK(c.frame_count() == 40);
    CHECK(c.camera_count() == 18);
    CHECK(c.train.size() == 32);
    CHECK(c.test.size() == 8);
    CHECK(c.novel_gaze.size() == 6);
    CHECK(c.independent_gaze == std::vector<int>{38, 39});
    CHECK(c.expression_width() == 45);
    CHECK(c.images_over_black);
    CHECK(c.has_eye_masks);
    CHECK(c.frames[0].landmarks.cols() == 66);
    CHECK(c.frames[0].vertices.cols() == 2700);
    CHECK(std::abs(c.camera(0, 8).fx - 906.2015) < 1e-3);
    for (const int k : eye_landmarks(1)) CHECK(c.frames[0].landmarks(0, k) < 0);
    const Image<float> mask = c.mask(0, 8), eyes = c.eye_mask(0, 8);
    CHECK(mask.at(128, 128)[0] == 1.0f);
    CHECK(eyes.pixels.row(0).sum() > 100);
    CHECK(eyes.pixels.row(1).sum() > 100);
}
