// SPDX-License-Identifier: Apache-2.0
#include <filesystem>
#include <fstream>
#include <functional>
#include <string>

#include <doctest/doctest.h>

#include <rye/io/npz.hpp>
#include <rye/rig/gaze.hpp>

#include "../support/hostile.hpp"
#include "comparison.hpp"
#include "data/checksums.hpp"
#include "data/json.hpp"
#include "data/validate.hpp"
#include "importers/import_folder.hpp"
#include "sources.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

/// One source for all tests of this file: in metres, larger pictures, as an iris needs pixels.
struct Source {
    TemporaryFolder folder;
    TrueScene truth;
    Source() {
        CaptureSettings s = small_settings();
        s.size = 224;
        truth = true_scene(folder.path / "truth", s);
        write_gha_source(truth, folder.path / "source", 0.1);
    }
    static const Source& one() {
        static const Source source;
        return source;
    }
    fs::path path() const { return folder.path / "source"; }
};

ImportOptions options(const fs::path& source, const fs::path& out, const fs::path& gaze = {}) {
    ImportOptions o;
    o.source = source;
    o.out = out;
    o.gaze = gaze;
    return o;
}

void check_refused(const std::string& words, const std::function<void(const fs::path&)>& damage) {
    const TemporaryFolder folder;
    const fs::path source = folder.path / "source";
    fs::copy(Source::one().path(), source, fs::copy_options::recursive);
    damage(source);
    CHECK_FAULT(import_gha(options(source, folder.path / "out")), words);
    CHECK(!fs::exists(folder.path / "out" / "capture.json"));
}

void check_gaze_refused(const std::string& name, const std::string& text,
                        const std::string& words) {
    const TemporaryFolder folder;
    std::ofstream(folder.path / name) << text;
    CHECK_FAULT(import_gha(options(Source::one().path(), folder.path / "out", folder.path / name)),
                words);
}

} // namespace

TEST_CASE("gha: eye masks from the lids, the gaze from the iris, and both are marked as derived") {
    const TemporaryFolder folder;
    const Source& source = Source::one();
    const ImportSummary summary = import_gha(options(source.path(), folder.path / "out"));
    const Capture got = read_trainable_capture(folder.path / "out");
    const Comparison c = compare(source.truth.capture, got);
    INFO(c.text());
    CHECK(c.mean_gaze_deg < 8);
    CHECK(c.landmarks < 1e-4);
    CHECK(c.projection_px < 0.01);
    CHECK(c.mean_overlap > 0.6);
    REQUIRE(summary.derived.size() >= 3);
    CHECK(summary.derived[0].find("eye masks: the polygons of the lids' landmarks") !=
          std::string::npos);
    CHECK(summary.derived[1].find("gaze from the iris in ") == 0);
    CHECK(summary.derived[1].find("degrees in the mean") != std::string::npos);
    CHECK(summary.derived.back() == "lengths times 10, so that a head spans about 2 units");
    CHECK(read_json(folder.path / "out" / "capture.json").at("import").at("derived").size() ==
          summary.derived.size());
    CHECK(import_gha(options(source.path(), folder.path / "out")).written == 0);
}

TEST_CASE("gha: the gaze of a file, as CSV and as npz") {
    const TemporaryFolder folder;
    const Source& source = Source::one();
    const Capture& truth = source.truth.capture;
    write_gazes(source.truth, folder.path / "gaze.csv");
    import_gha(options(source.path(), folder.path / "csv", folder.path / "gaze.csv"));
    CHECK(compare(truth, read_trainable_capture(folder.path / "csv")).gaze_deg < 1e-3);

    NpzArrays arrays;
    for (std::size_t e = 0; e < 2; ++e) {
        std::vector<double> rows;
        for (const CaptureFrame& f : truth.frames)
            for (Index d = 0; d < 3; ++d) rows.push_back(f.eyes[e].optical[d]);
        arrays[e == 0 ? "gaze_left" : "gaze_right"] =
            npy_array<double>({truth.frame_count(), 3}, std::span<const double>(rows));
    }
    write_npz(folder.path / "gaze.npz", arrays);
    import_gha(options(source.path(), folder.path / "npz", folder.path / "gaze.npz"));
    CHECK(compare(truth, read_trainable_capture(folder.path / "npz")).gaze_deg < 1e-3);
}

TEST_CASE("gha: what a capture has is kept: a rye capture without eye masks gets them") {
    const TemporaryFolder folder;
    const Source& source = Source::one();
    const fs::path from = folder.path / "from";
    fs::copy(source.truth.capture.folder, from, fs::copy_options::recursive);
    for (const auto& entry : fs::recursive_directory_iterator(from))
        if (entry.path().filename().string().starts_with("eye_mask_")) fs::remove(entry.path());
    CHECK_FAULT(read_trainable_capture(from), "`rye import gha ");
    const ImportSummary summary = import_gha(options(from, folder.path / "out"));
    const Capture got = read_trainable_capture(folder.path / "out");
    CHECK(compare(source.truth.capture, got).gaze_deg < 1e-6);
    CHECK(got.images_over_black);
    CHECK(got.novel_gaze.size() == source.truth.capture.novel_gaze.size());
    CHECK(summary.found.back() == "gaze of every frame");
    // It states checksums of its own, not the source's.
    CHECK(read_json(from / "capture.json").contains("checksum"));
    CHECK(changed_files(folder.path / "out").empty());
    // Conventions may be any text.
    nlohmann::json about = read_json(from / "capture.json");
    about.erase("checksum");
    about["conventions"] = "metres";
    std::ofstream(from / "capture.json") << about;
    import_gha(options(from, folder.path / "text"));
    CHECK(read_json(folder.path / "text/capture.json").at("conventions").at("source") == "metres");
}

TEST_CASE("gha: wrong sources are refused by file, field and value") {
    check_refused("images: no such folder",
                  [](const fs::path& s) { fs::remove_all(s / "images"); });
    check_refused("params/0001/lmk_3d.npy: got 60 landmarks, expected 66 or 68",
                  [](const fs::path& s) {
                      const std::vector<double> v(180, 1.0);
                      write_npy(s / "params/0001/lmk_3d.npy",
                                npy_array<double>({60, 3}, std::span<const double>(v)));
                  });
    check_refused("params/0000/params.npz: pose: got shape (1, 5), expected 6 numbers",
                  [](const fs::path& s) {
                      NpzArrays arrays = read_npz(s / "params/0000/params.npz");
                      const std::vector<double> v(5, 0.0);
                      arrays["pose"] = npy_array<double>({1, 5}, std::span<const double>(v));
                      write_npz(s / "params/0000/params.npz", arrays);
                  });
    check_refused("extrinsic: its 3 x 3 part is no rotation", [](const fs::path& s) {
        for (const auto& entry : fs::directory_iterator(s / "cameras/0002")) {
            NpzArrays arrays = read_npz(entry.path());
            std::vector<double> v = arrays["extrinsic"].values<double>("extrinsic");
            v[0] += 0.5;
            arrays["extrinsic"] = npy_array<double>({3, 4}, std::span<const double>(v));
            write_npz(entry.path(), arrays);
            break;
        }
    });
    check_refused("scale: got 0", [](const fs::path& s) {
        NpzArrays arrays = read_npz(s / "params/0001/params.npz");
        const std::vector<double> v{0};
        arrays["scale"] = npy_array<double>({1, 1}, std::span<const double>(v));
        write_npz(s / "params/0001/params.npz", arrays);
    });
    check_refused("in no frame was an iris found", [](const fs::path& s) {
        for (const auto& entry : fs::recursive_directory_iterator(s / "images")) {
            const std::string name = entry.path().filename().string();
            if (name.starts_with("image_"))
                write_jpeg(entry.path(),
                           Image8{224, 224, 3, std::vector<std::uint8_t>(224 * 224 * 3, 90)}, 90);
        }
    });
}

TEST_CASE("gha: wrong files of gazes are refused by line, field and value") {
    const std::string header = "frame,left_pitch,left_yaw,right_pitch,right_yaw\n";
    check_gaze_refused("gaze.csv", "frame,yaw\n", "gaze.csv: line 1: got 'frame,yaw', expected");
    check_gaze_refused("gaze.csv", header + "0000,1,2,3\n", "line 2: got 4 fields, expected 5");
    check_gaze_refused("gaze.csv", header + "0000,1,x,3,4\n",
                       "line 2: left_yaw: got 'x', expected degrees");
    check_gaze_refused("gaze.csv", header + "0000,1,80,3,4\n", "line 2: left: got 80.0");
    check_gaze_refused("gaze.csv", header + "0000,1,2,3,4\n0000,1,2,3,4\n",
                       "line 3: names the frame '0000' twice");
    check_gaze_refused("gaze.csv", header + "0000,1,2,3,4\n", "has no line for the frame '0001'");
    check_gaze_refused("gaze.txt", header,
                       "gaze.txt: got the ending '.txt', expected .csv or .npz");
}
