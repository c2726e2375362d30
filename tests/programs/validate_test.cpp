// SPDX-License-Identifier: Apache-2.0
// With RYE_DATA set to a folder with capture_a, that capture must be valid.
#include "../support/real_data.hpp"
#include "data/validate.hpp"

#include <filesystem>
#include <string>

#include <doctest/doctest.h>

#include "../support/hostile.hpp"
#include "command_line.hpp"
#include "data/picture.hpp"
#include "tiny_capture.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

std::vector<Problem> problems_of(const fs::path& folder) {
    std::vector<Problem> problems;
    const Capture capture = read_capture(folder, {}, &problems);
    for (const Problem& p : validate(capture)) problems.push_back(p);
    return problems;
}

std::string text_of(const std::vector<Problem>& problems) {
    std::string text;
    for (const Problem& p : problems)
        text += (p.severity == Problem::Severity::error ? "error " : "warning ") + p.message + "\n";
    return text;
}

bool tells(const std::vector<Problem>& problems, Problem::Severity severity,
           const std::string& words) {
    for (const Problem& p : problems)
        if (p.severity == severity && p.message.find(words) != std::string::npos) return true;
    return false;
}

Answer info(const fs::path& folder) { return answer({"info", folder.string()}); }

/// After the damage validation reports an error with these words, training throws (with these
/// words, or those of the fault that explains it), and info exits with 1.
template <class F>
void check_error(const std::string& words, F&& damage, const std::string& cause = "") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    damage(tiny);
    const std::vector<Problem> problems = problems_of(folder.path);
    INFO("expected: ", words);
    INFO("told: ", text_of(problems));
    CHECK(tells(problems, Problem::Severity::error, words));
    for (const Problem& p : problems) // one sentence each, with the file's path
        CHECK(p.message.find(folder.path.string()) != std::string::npos);
    CHECK_FAULT(read_valid_capture(folder.path), cause.empty() ? words : cause);
    const Answer outcome = info(folder.path);
    CHECK(outcome.code == 1);
    CHECK(outcome.printed.find(words) != std::string::npos);
}

template <class F>
void check_warning(const std::string& words, F&& damage) {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    damage(tiny);
    const std::vector<Problem> problems = problems_of(folder.path);
    INFO("expected: ", words);
    INFO("told: ", text_of(problems));
    CHECK(tells(problems, Problem::Severity::warning, words));
    std::vector<Problem> warnings;
    CHECK_NOTHROW(read_valid_capture(folder.path, {}, &warnings));
    CHECK(tells(warnings, Problem::Severity::warning, words));
    CHECK(info(folder.path).code == 0);
}

using Values = std::vector<double>;

void scale_all(const TinyCapture& t, double factor) {
    const auto by = [&](Values& v) {
        for (double& x : v) x *= factor;
    };
    t.edit_all("lmk_3d.npy", "", by);
    t.edit_all("params.npz", "pose", [&](Values& v) {
        for (int i = 3; i < 6; ++i) v[std::size_t(i)] *= factor;
    });
    t.edit_all("params.npz", "scale", by);
    t.edit_all("camera", "extrinsic", [&](Values& v) {
        for (const int i : {3, 7, 11}) v[std::size_t(i)] *= factor;
    });
    for (const char* name :
         {"eye_center_left", "eye_center_right", "eye_radius", "limbus_radius", "iris_plane"})
        t.edit_all("gaze.npz", name, by);
}

void negate_rows_2_and_3(Values& extrinsic) {
    for (std::size_t i = 4; i < 12; ++i) extrinsic[i] *= -1;
}

void invert(Values& e) {
    Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> m(e.data());
    const Mat3<double> r = m.leftCols<3>();
    const Vec3<double> t = m.col(3);
    m.leftCols<3>() = r.transpose();
    m.col(3) = -(r.transpose() * t);
}

} // namespace

TEST_CASE("validate: a sound capture has no problem, and info describes it") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    const std::vector<Problem> problems = problems_of(folder.path);
    INFO("told: ", text_of(problems));
    CHECK(problems.empty());
    const Answer outcome = info(folder.path);
    CHECK(outcome.code == 0);
    for (const char* words : {"48 x 48", "training    3 (0000 to 0002)", "test        1 (0003)",
                              "cameras       3: yaw", "2 numbers a frame", "66, and 5 vertices",
                              "100.0 % of the landmarks", "kappa yaw 5.00 pitch -1.50", "usable"}) {
        INFO("printed: ", outcome.printed);
        INFO("expected: ", words);
        CHECK(outcome.printed.find(words) != std::string::npos);
    }
}

TEST_CASE("validate: files that are missing, empty, cut or of the wrong shape") {
    using T = const TinyCapture&;
    check_error("params.npz: no such file", [](T t) { fs::remove(t.params(1, "params.npz")); });
    check_error("lmk_3d.npy: no such file", [](T t) { fs::remove(t.params(1, "lmk_3d.npy")); });
    check_error("camera_c1.npz: no such file", [](T t) { fs::remove(t.camera_file(2, 1)); });
    check_error("mask_c2.png or .jpg: no such file",
                [](T t) { fs::remove(t.image(0, 2, "mask")); });
    check_error("image_c2.jpg or .png: no such file", [](T t) { fs::remove(t.image(0, 2)); });
    check_error("has no folders", [](T t) {
        for (int f = 0; f < 4; ++f) fs::remove_all(t.folder / "images" / t.frame(f));
    });
    check_error("image_c0.png: got 0 bytes", [](T t) { write_atomic(t.image(1, 0), {}); });
    check_error("mask_c0.png: PNG: truncated", [](T t) {
        const Bytes whole = read_file(t.image(0, 0, "mask"));
        write_atomic(t.image(0, 0, "mask"), ByteSpan(whole).first(whole.size() - 20));
    });
    check_error("camera_c0.npz: truncated", [](T t) {
        const Bytes whole = read_file(t.camera_file(0, 0));
        write_atomic(t.camera_file(0, 0), ByteSpan(whole).first(whole.size() / 2));
    });
    check_error("mask_c1.png: got 8 x 8 pixels, expected 48 x 48", [](T t) {
        write_png(t.image(1, 1, "mask"), Image8{8, 8, 1, std::vector<std::uint8_t>(64, 255)});
    });
    check_error("lmk_3d.npy: got shape (68, 2), expected (N, 3)", [](T t) {
        write_npy(t.params(0, "lmk_3d.npy"),
                  npy_array<double>(Columns<double>::Zero(2, 68).eval()));
    });
    check_error("lmk_3d.npy: got 70 landmarks, expected 66 or 68", [](T t) {
        write_npy(t.params(0, "lmk_3d.npy"),
                  npy_array<double>(Columns<double>::Zero(3, 70).eval()));
    });
    check_error("params.npz: pose: got shape (5,), expected 6 numbers",
                [](T t) { t.set(t.params(0, "params.npz"), "pose", {5}, Values(5, 0)); });
    check_error("params.npz: exp_coeff: is missing from the file",
                [](T t) { t.remove(t.params(0, "params.npz"), "exp_coeff"); });
    check_error("length of exp_coeff: got 3, expected 2 as in frame 0000", [](T t) {
        t.set(t.params(2, "params.npz"), "exp_coeff", {1, 3}, Values(3, 0));
    });
    check_error("extrinsic: got shape (12,), expected (3, 4)", [](T t) {
        t.set(t.camera_file(0, 0), "extrinsic", {12}, t.get(t.camera_file(0, 0), "extrinsic"));
    });
    check_error("gaze.npz: gaze_left: is missing",
                [](T t) { t.remove(t.params(0, "gaze.npz"), "gaze_left"); });
}

TEST_CASE("validate: numbers that are none") {
    using T = const TinyCapture&;
    const auto spoil = [](Values& v) { v[2] = std::nan(""); };
    check_error("camera_c1.npz: intrinsic: value 2 is",
                [&](T t) { t.edit_one(t.camera_file(1, 1), "intrinsic", spoil); });
    check_error("camera_c1.npz: extrinsic: value 2 is",
                [&](T t) { t.edit_one(t.camera_file(1, 1), "extrinsic", spoil); });
    check_error("lmk_3d.npy: value 2 is",
                [&](T t) { t.edit_one(t.params(1, "lmk_3d.npy"), "", spoil); });
    check_error("pose: value 2 is",
                [&](T t) { t.edit_one(t.params(1, "params.npz"), "pose", spoil); });
    check_error("gaze_right: value 2 is",
                [&](T t) { t.edit_one(t.params(1, "gaze.npz"), "gaze_right", spoil); });
    check_error("scale: got 0",
                [&](T t) { t.set(t.params(1, "params.npz"), "scale", {1}, Values{0}); });
    check_error("focal lengths -", [&](T t) {
        t.edit_one(t.camera_file(0, 0), "intrinsic", [](Values& v) { v[0] *= -1; });
    });
    check_error("got skew", [&](T t) {
        t.edit_one(t.camera_file(0, 0), "intrinsic", [](Values& v) { v[1] = 1; });
    });
}

TEST_CASE("validate: capture.json that does not hold") {
    using T = const TinyCapture&;
    const auto json = [](const char* text) {
        return [text](T t) { t.write_text("capture.json", text); };
    };
    check_error("train_frames is empty", json(R"({"train_frames": [], "test_frames": ["0000"]})"));
    check_error("0009: no such folder, but capture.json names",
                json(R"({"train_frames": ["0000", "0009"]})"));
    check_error("'0001' is in train_frames and in a list of test frames",
                json(R"({"train_frames": ["0001"], "novel_gaze_test_frames": ["0001"]})"));
    check_error("names '0001' twice", json(R"({"train_frames": ["0001", "0001"]})"));
    check_error("without slashes", json(R"({"train_frames": ["../0001"]})"));
    check_error("got 7, expected a name", json(R"({"train_frames": [7]})"));
    check_error("expected a list of names", json(R"({"train_frames": "0001"})"));
    check_error("capture.json: JSON at byte 18: expected a value", json("{\"train_frames\": ["));
    check_error("capture.json: expected an object", json("[]"));
    check_error("image_size: got [64,64], but the images have 48 x 48",
                json(R"({"image_size": [64, 64]})"));
    check_error("exp_names: got 1 names", json(R"({"exp_names": ["a"]})"));
    check_error("images: camera c9 has no whole frame",
                json(R"({"train_frames": ["0001"], "camera_ids": ["c0", "c9"]})"));
}

TEST_CASE("validate: units") {
    check_error("it looks like millimetres: multiply",
                [](const TinyCapture& t) { scale_all(t, 100); });
    check_error("it looks like metres: multiply", [](const TinyCapture& t) { scale_all(t, 0.1); });
    check_error("multiply the translation in extrinsic by 0.01", [](const TinyCapture& t) {
        t.edit_all("camera", "extrinsic", [](Values& v) {
            for (const int i : {3, 7, 11}) v[std::size_t(i)] *= 100;
        });
    });
    check_error("intrinsic belongs to images of another size", [](const TinyCapture& t) {
        t.edit_all("camera", "intrinsic", [](Values& v) {
            for (const int i : {0, 2, 4, 5}) v[std::size_t(i)] *= 8;
        });
    });
    check_error("are these degrees?", [](const TinyCapture& t) {
        t.edit_all("params.npz", "pose", [](Values& v) {
            for (const int i : {0, 1, 2}) v[std::size_t(i)] *= 180;
        });
    });
}

TEST_CASE("validate: axes") {
    using T = const TinyCapture&;
    check_error("OpenGL axes (y up, z backward): negate rows 2 and 3",
                [](T t) { t.edit_all("camera", "extrinsic", negate_rows_2_and_3); });
    check_error(
        "the head is behind the camera",
        [](T t) { t.edit_all("camera", "extrinsic", negate_rows_2_and_3); }, "negate rows 2 and 3");
    check_error("extrinsic is camera to world: invert it",
                [](T t) { t.edit_all("camera", "extrinsic", invert); });
    check_error("as in NeRF", [](T t) {
        t.edit_all("camera", "extrinsic", [](Values& v) {
            negate_rows_2_and_3(v);
            invert(v);
        });
    });
    check_error("is no rotation: R R^T differs", [](T t) {
        t.edit_one(t.camera_file(0, 0), "extrinsic", [](Values& v) { v[0] += 0.1; });
    });
    check_error("the camera is mirrored", [](T t) {
        t.edit_one(t.camera_file(0, 0), "extrinsic", [](Values& v) {
            for (int i = 0; i < 4; ++i) v[std::size_t(i)] *= -1;
        });
    });
    check_error("the brows (y = ", [](T t) {
        t.edit_all("lmk_3d.npy", "", [](Values& v) {
            for (std::size_t i = 0; i < v.size(); ++i)
                if (i % 3) v[i] *= -1;
        });
    });
    check_error("left eye (landmarks 42 to 47", [](T t) {
        t.edit_all("lmk_3d.npy", "", [](Values& v) {
            for (std::size_t i = 0; i < v.size(); i += 3) v[i] *= -1;
        });
    });
    check_error("pose and lmk_3d do not belong together", [](T t) {
        t.edit_one(t.params(1, "params.npz"), "pose", [](Values& v) { v[3] += 1.0; });
    });
}

TEST_CASE("validate: gaze and eyes") {
    using T = const TinyCapture&;
    check_error("gaze_left: its length is 2", [](T t) {
        t.edit_all("gaze.npz", "gaze_left", [](Values& v) {
            for (double& x : v) x *= 2;
        });
    });
    check_error("so the eye looks into the head",
                [](T t) { t.edit_all("gaze.npz", "gaze_right", [](Values& v) { v[2] *= -1; }); });
    check_error("gaze_left_world is", [](T t) {
        t.edit_all("gaze.npz", "gaze_left_world", [](Values& v) { v[0] += 0.2; });
    });
    check_error("of the face away from the lids", [](T t) {
        t.edit_all("gaze.npz", "eye_center_left", [](Values& v) { v[0] *= -1; });
    });
    check_error("eye_radius: got 15", [](T t) {
        t.edit_all("gaze.npz", "eye_radius", [](Values& v) {
            for (double& x : v) x *= 100;
        });
    });
    check_error("are on the other eye's lids", [](T t) {
        for (int f = 0; f < 4; ++f)
            for (int c = 0; c < 3; ++c) {
                Image8 labels = read_image8(t.image(f, c, "eye_mask"), 1);
                for (auto& v : labels.values) v = v == 0 ? 0 : static_cast<std::uint8_t>(255 - v);
                write_png(t.image(f, c, "eye_mask"), labels);
            }
    });
    check_error("got the value 7, expected 0 (none)", [](T t) {
        write_png(t.image(0, 0, "eye_mask"),
                  Image8{48, 48, 1, std::vector<std::uint8_t>(48 * 48, 7)});
    });
    check_error("the mask is empty", [](T t) {
        write_png(t.image(0, 0, "mask"), Image8{48, 48, 1, std::vector<std::uint8_t>(48 * 48, 0)});
    });
    check_warning("expected equal",
                  [](T t) { t.edit_all("gaze.npz", "kappa_left", [](Values& v) { v[0] *= -1; }); });
    check_warning("can neither be trained nor redirected",
                  [](T t) { fs::remove(t.params(0, "gaze.npz")); });
    check_warning("placed by the landmarks of the lids", [](T t) {
        for (int f = 0; f < 4; ++f) t.remove(t.params(f, "gaze.npz"), "eye_center_left");
    });
    check_warning("the loss on the eyes alone", [](T t) { fs::remove(t.image(0, 0, "eye_mask")); });
    check_warning("expressions will not be learned", [](T t) {
        t.edit_all("params.npz", "exp_coeff", [](Values& v) { v.assign(v.size(), 0); });
    });
    check_warning("though it should be over black", [](T t) {
        t.write_text("capture.json", R"({"conventions": {"image": "over black"}})");
        write_png(t.image(0, 0), Image8{48, 48, 3, std::vector<std::uint8_t>(48 * 48 * 3, 200)});
    });
}

TEST_CASE("validate: what training would refuse or overflow on is an error of the capture") {
    using T = const TinyCapture&;
    check_error("exp_coeff: values from 0 to inf, expected a few units at most", [](T t) {
        t.edit_all("params.npz", "exp_coeff", [](Values& v) { v[0] = 1e300; });
    });
    check_error("exp_coeff: values from -1e+04 to", [](T t) {
        t.edit_one(t.params(2, "params.npz"), "exp_coeff", [](Values& v) { v[1] = -1e4; });
    });
    check_error("vertices.npy: vertex 3 is 1e+30 units from landmarks", [](T t) {
        t.edit_one(t.params(1, "vertices.npy"), "", [](Values& v) { v[9] = 1e30; });
    });
    check_error("by which the landmarks span", [](T t) {
        t.edit_all("params.npz", "scale", [](Values& v) { v[0] = 1e-30; });
    });
    check_error("iris_plane 0.220000 make no eyeball (in canonical units): eyeball_template: "
                "iris plane at z = 0.22, expected above 0 and at most",
                [](T t) {
                    t.edit_one(t.params(3, "gaze.npz"), "iris_plane", [](Values& v) { v[1] = 0.22; });
                });
}

TEST_CASE("validate: two eyes that differ are usable") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    tiny.edit_all("gaze.npz", "limbus_radius", [](Values& v) { v = {0.0585, 0.06}; });
    tiny.edit_all("gaze.npz", "eye_radius", [](Values& v) { v = {0.15, 0.14}; });
    const Answer outcome = info(folder.path);
    CHECK(outcome.code == 0);
    CHECK(outcome.printed.find("verdict       usable\n") != std::string::npos);
    CHECK_NOTHROW(read_trainable_capture(folder.path));
}

TEST_CASE("validate: a capture that can be drawn but not trained on is not called usable") {
    const auto check = [](const std::string& words, auto&& damage) {
        const TemporaryFolder folder;
        const TinyCapture tiny(folder.path);
        damage(tiny);
        CHECK_NOTHROW(read_valid_capture(folder.path));
        CHECK_FAULT(read_trainable_capture(folder.path), words);
        CHECK_FAULT(read_trainable_capture(folder.path), "`rye import gha ");
        const Answer outcome = info(folder.path);
        INFO(outcome.printed);
        CHECK(outcome.code == 0);
        CHECK(outcome.printed.find("verdict       usable to draw and measure, not to train: ") !=
              std::string::npos);
        CHECK(outcome.printed.find(words) != std::string::npos);
    };
    check("gaze.npz: no such file, expected the gaze of every frame",
          [](const TinyCapture& t) { fs::remove(t.params(1, "gaze.npz")); });
    check("some images have no eye_mask_<camera>.png",
          [](const TinyCapture& t) { fs::remove(t.image(0, 0, "eye_mask")); });
}

TEST_CASE("validate: few cameras or frames are usable, and the verdict states what to expect") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    for (int f = 0; f < TinyCapture::frames; ++f)
        for (int c = 1; c < TinyCapture::cameras; ++c) {
            for (const char* stem : {"image", "mask", "eye_mask"})
                fs::remove(tiny.image(f, c, stem));
            fs::remove(tiny.camera_file(f, c));
        }
    std::vector<std::string> expect;
    const Capture capture = read_trainable_capture(folder.path, &expect);
    CHECK(capture.camera_count() == 1);
    REQUIRE(expect.size() == 2);
    CHECK(expect[0].find("1 camera: sides of the head that no image shows") != std::string::npos);
    CHECK(expect[1].find("3 training frames: ") != std::string::npos);
    const Answer outcome = info(folder.path);
    CHECK(outcome.code == 0);
    for (const std::string& words : expect)
        CHECK(outcome.printed.find("warning: " + words + "\n") != std::string::npos);
    CHECK(outcome.printed.find("verdict       usable\n") != std::string::npos);
}

TEST_CASE("validate: pictures without a tracked head name the command that makes the rest") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    fs::remove_all(folder.path / "params");
    CHECK_FAULT(read_trainable_capture(folder.path), "params: no such folder");
    CHECK_FAULT(read_trainable_capture(folder.path), "`rye import vhap TRACKED --out CAPTURE`");
    const Answer outcome = info(folder.path);
    CHECK(outcome.code == 1);
    CHECK(outcome.printed.find("verdict       1 errors: not usable") != std::string::npos);
}

TEST_CASE("validate: many faults are told together, repeated ones once with their number") {
    const TemporaryFolder folder;
    const TinyCapture tiny(folder.path);
    fs::remove(tiny.camera_file(0, 0));
    tiny.edit_all("gaze.npz", "gaze_left", [](Values& v) {
        for (double& x : v) x *= 2;
    });
    tiny.edit_all("gaze.npz", "eye_radius", [](Values& v) {
        for (double& x : v) x *= 100;
    });
    const std::string told = text_of(problems_of(folder.path));
    INFO("told: ", told);
    CHECK(told.find("camera_c0.npz: no such file") != std::string::npos);
    CHECK(told.find("expected a unit vector (and 3 more like this)") != std::string::npos);
    CHECK(told.find("eye_radius: got 15") != std::string::npos);
}

TEST_CASE("validate: a folder that is not there") {
    const TemporaryFolder folder;
    CHECK(info(folder.path / "nowhere").code == 1);
    CHECK_FAULT(read_valid_capture(folder.path / "nowhere"), "nowhere: no such folder");
    CHECK_FAULT(read_capture(folder.path), "images: no such folder");
}

TEST_CASE("validate: the real capture is sound") {
    const auto folder = test::real_data("capture_a");
    if (!folder) return;
    const Capture c = read_capture(*folder);
    const std::vector<Problem> problems = validate(c, ImagesToDecode::all);
    INFO("told: ", text_of(problems));
    CHECK(problems.empty());
    CHECK(landmark_span(c) > 1.8);
    CHECK(landmark_span(c) < 2.6);
    CHECK(fit_landmarks(c).inside_mask > 0.95);
}
