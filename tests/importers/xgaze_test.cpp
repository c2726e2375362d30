// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iostream>
#include <string>

#include <doctest/doctest.h>

#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "../support/hostile.hpp"
#include "comparison.hpp"
#include "data/json.hpp"
#include "data/validate.hpp"
#include "importers/face_geometry.hpp"
#include "importers/hdf5_file.hpp"
#include "importers/import_folder.hpp"
#include "sources.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

struct Source {
    TemporaryFolder folder;
    TrueScene truth;
    Source() {
        CaptureSettings s = small_settings();
        s.cameras = 6;
        s.train_frames = 2;
        truth = true_scene(folder.path / "truth", s);
        write_xgaze_source(truth, folder.path / "xgaze.h5", folder.path / "calibration",
                           XgazeFields::normalization);
        write_xgaze_source(truth, folder.path / "gazenerf.h5", {}, XgazeFields::gazenerf);
    }
    static const Source& one() {
        static const Source source;
        return source;
    }
};

ImportOptions options(const fs::path& source, const fs::path& out,
                      const fs::path& calibration = {}) {
    ImportOptions o;
    o.source = source;
    o.out = out;
    o.calibration = calibration;
    return o;
}

/// Largest angle between the imported gaze and the middle of the true ones, head frames as they
/// lie in the image.
double gaze_difference(const Capture& truth, const Capture& got) {
    double most = 0;
    for (int f = 0; f < truth.frame_count(); ++f) {
        const CaptureFrame& a = truth.frames[static_cast<std::size_t>(f)];
        const CaptureFrame& b = got.frames[static_cast<std::size_t>(f)];
        const auto seen = [&](const Capture& c, const CaptureFrame& frame, const Vec3<double>& g) {
            // In the first camera of the frame: the normalised one is turned, so in the world of
            // the true capture by the landmarks.
            static_cast<void>(c);
            return Vec3<double>(so3_exp(Vec3<double>(frame.pose.head<3>())) * g);
        };
        const double size =
            (a.landmarks.colwise() - Vec3<double>(a.landmarks.rowwise().mean())).norm() /
            (b.landmarks.colwise() - Vec3<double>(b.landmarks.rowwise().mean())).norm();
        const Rigid<double> motion = fit_rigid(size * b.landmarks, a.landmarks);
        const Vec3<double> middle = a.eyes[0].optical + a.eyes[1].optical;
        most = std::max(
            most, 57.29577951308232 *
                      angular_error<double>(seen(truth, a, middle),
                                            motion.rotation * seen(got, b, b.eyes[0].optical)));
    }
    return most;
}

void check_refused(const std::string& words, const std::function<void(ImportOptions&)>& damage) {
    const TemporaryFolder folder;
    const Source& s = Source::one();
    fs::copy(s.folder.path / "xgaze.h5", folder.path / "xgaze.h5");
    fs::copy(s.folder.path / "calibration", folder.path / "calibration");
    ImportOptions o =
        options(folder.path / "xgaze.h5", folder.path / "out", folder.path / "calibration");
    damage(o);
    CHECK_FAULT(import_xgaze(o), words);
    CHECK(!fs::exists(folder.path / "out" / "capture.json"));
}

void replace_in(const fs::path& path, const std::string& old, const std::string& now) {
    const Bytes bytes = read_file(path);
    std::string text(as_text(bytes));
    REQUIRE(text.find(old) != std::string::npos);
    text.replace(text.find(old), old.size(), now);
    std::ofstream(path, std::ios::binary) << text;
}

bool not_run() {
    if (has_hdf5()) return false;
    std::cout << "not run: import of xgaze: rye was built without libhdf5\n";
    return true;
}

} // namespace

TEST_CASE("xgaze: LZF is undone, and damage is an error") {
    const std::vector<std::uint8_t> packed{2, 'a', 'b', 'c', 0x20, 2, 0xE0, 1, 0};
    const std::vector<std::uint8_t> all = decode_lzf(packed.data(), packed.size(), 16, "x");
    CHECK(std::string(all.begin(), all.end()) == "abcabccccccccccc" + std::string());
    CHECK_FAULT(decode_lzf(packed.data(), packed.size(), 15, "x"), "x: its LZF data are damaged");
    CHECK_FAULT(decode_lzf(packed.data(), packed.size(), 17, "x"), "x: its LZF data make 16 bytes");
    CHECK_FAULT(decode_lzf(packed.data(), 3, 16, "x"), "x: its LZF data are damaged");
    const std::vector<std::uint8_t> before{0x20, 5};
    CHECK_FAULT(decode_lzf(before.data(), 2, 3, "x"), "x: its LZF data are damaged");
}

TEST_CASE("xgaze: patches of the normalisation with calibration") {
    if (not_run()) return;
    const Source& s = Source::one();
    const TemporaryFolder folder;
    const ImportSummary summary = import_xgaze(
        options(s.folder.path / "xgaze.h5", folder.path / "out", s.folder.path / "calibration"));
    CHECK(summary.frames == s.truth.capture.frame_count());
    const Capture got = read_trainable_capture(folder.path / "out");
    const Comparison c = compare(s.truth.capture, got);
    INFO(c.text());
    CHECK(c.landmarks < 1e-3);
    CHECK(c.pose_deg < 0.2); // though mouth and brows move
    CHECK(gaze_difference(s.truth.capture, got) < 0.01);
    CHECK(got.camera_ids.size() == 6);
    CHECK(got.expression_width() == 1);
    CHECK(summary.missing.front().find("expression coefficients: one that is 0") == 0);
    CHECK(summary.found.front().find(", 3 empty rows") != std::string::npos);
    CHECK(summary.found.back().find("world to camera") != std::string::npos);
    // Black pixels that reach the border are padding; the rest of a patch is not.
    double padded = 0, all = 0;
    for (int k = 0; k < got.camera_count(); ++k) {
        padded += (1.0f - got.visible(0, k).pixels.array()).sum();
        all += static_cast<double>(got.visible(0, k).size());
    }
    CHECK(padded < 0.9 * all);
    CHECK(import_xgaze(options(s.folder.path / "xgaze.h5", folder.path / "out",
                               s.folder.path / "calibration"))
              .written == 0);
}

TEST_CASE("xgaze: a calibration that goes from camera to world, and cameras that hang, are read") {
    if (not_run()) return;
    const Source& s = Source::one();
    const TemporaryFolder folder;
    fs::create_directories(folder.path / "calibration");
    // Camera 3 was turned before normalisation: its calibration is of the picture that hangs.
    for (int k = 0; k < 6; ++k) {
        const Pinhole<double>& c = s.truth.capture.camera(0, k);
        Mat3<double> r = c.camera_from_world.rotation;
        Vec3<double> t = 100 * c.camera_from_world.translation;
        if (k == 3) {
            r = Vec3<double>(-1, -1, 1).asDiagonal() * r;
            t = Vec3<double>(-1, -1, 1).cwiseProduct(t);
        }
        const Rigid<double> inverse = Rigid<double>{r, t}.inverse();
        std::ofstream out(folder.path / "calibration" / ("cam0" + std::to_string(k) + ".xml"));
        out.precision(17);
        const auto matrix = [&](const char* name, const auto& m) {
            out << "<" << name << " type_id=\"opencv-matrix\">\n<rows>3</rows><cols>" << m.cols()
                << "</cols><dt>d</dt>\n<data>\n";
            for (Index i = 0; i < 3; ++i)
                for (Index j = 0; j < m.cols(); ++j) out << m(i, j) << " ";
            out << "</data></" << name << ">\n";
        };
        matrix("cam_rotation", inverse.rotation);
        matrix("cam_translation", inverse.translation);
    }
    const ImportSummary summary = import_xgaze(
        options(s.folder.path / "xgaze.h5", folder.path / "out", folder.path / "calibration"));
    CHECK(summary.found.back().find("camera to world, cameras 3, 6 and 13 turned") !=
          std::string::npos);
    const Capture got = read_trainable_capture(folder.path / "out");
    CHECK(compare(s.truth.capture, got).landmarks < 1e-3);
}

TEST_CASE("xgaze: patches with GazeNeRF's fields") {
    if (not_run()) return;
    const Source& s = Source::one();
    const TemporaryFolder folder;
    const ImportSummary summary =
        import_xgaze(options(s.folder.path / "gazenerf.h5", folder.path / "out"));
    const Capture got = read_trainable_capture(folder.path / "out");
    const Comparison c = compare(s.truth.capture, got);
    INFO(c.text());
    CHECK(c.landmarks < 1e-3);
    CHECK(c.projection_px < 0.01);
    CHECK(c.mask_difference == 0);
    CHECK(c.eye_overlap > 0.95);
    CHECK(gaze_difference(s.truth.capture, got) < 0.01);
    CHECK(got.expression_width() == 79);
    const std::vector<float>&codes = got.frames[1].expression,
        &is = s.truth.capture.frames[1].expression;
    REQUIRE(is.size() < 79);
    for (std::size_t i = 0; i < codes.size(); ++i)
        CHECK(codes[i] == doctest::Approx(i < is.size() ? is[i] : 0));
    CHECK(std::any_of(is.begin(), is.end(), [](float x) { return x > 0.1f; }));
    // Colours are stored as BGR.
    const Image<float> a = s.truth.capture.image(0, 0), b = got.image(0, 0), m = got.mask(0, 0);
    for (Index i = 0; i < m.size(); ++i)
        if (m.pixels(0, i) == 1) CHECK((a.pixels.col(i) - b.pixels.col(i)).norm() < 0.01f);
    CHECK(summary.found.back() == "79 expression codes of GazeNeRF's 3DMM");
}

TEST_CASE("xgaze: wrong sources are refused by file, field and value") {
    if (not_run()) return;
    check_refused("xgaze.h5: is not an HDF5 file, or is damaged",
                  [](ImportOptions& o) { std::ofstream(o.source) << "no"; });
    check_refused("xgaze.h5: face_mat_norm: needs the cameras' calibration",
                  [](ImportOptions& o) { o.calibration.clear(); });
    check_refused("cam02.xml: no such file",
                  [](ImportOptions& o) { fs::remove(o.calibration / "cam02.xml"); });
    check_refused("cam01.xml: cam_rotation: is missing, expected a matrix", [](ImportOptions& o) {
        replace_in(o.calibration / "cam01.xml", "<cam_rotation", "<cam_rotatio");
    });
    check_refused("--normalization: got 2 numbers, expected 3", [](ImportOptions& o) {
        o.normalization = {960, 300};
    });
    check_refused("xgaze.h5: facial_landmarks: row 1: ", [](ImportOptions& o) {
        fs::copy_file(o.calibration / "cam00.xml", o.calibration / "cam01.xml",
                      fs::copy_options::overwrite_existing);
        fs::copy_file(o.calibration / "cam00.xml", o.calibration / "cam02.xml",
                      fs::copy_options::overwrite_existing);
    });
    check_refused("is a folder, expected one HDF5 file",
                  [](ImportOptions& o) { o.source = o.source.parent_path(); });
}
