// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <string>

#include <doctest/doctest.h>

#include <rye/io/npz.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "../support/hostile.hpp"
#include "comparison.hpp"
#include "data/json.hpp"
#include "data/validate.hpp"
#include "importers/import_folder.hpp"
#include "sources.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

/// One source for all tests of this file.
struct Source {
    TemporaryFolder folder;
    TrueScene truth;
    Source() : truth(true_scene(folder.path / "truth", small_settings())) {
        write_vhap_source(truth, folder.path / "source");
    }
    static const Source& one() {
        static const Source source;
        return source;
    }
};

ImportOptions options(const fs::path& source, const fs::path& out) {
    ImportOptions o;
    o.source = source;
    o.out = out;
    return o;
}

/// Imports a damaged copy of the source.
void check_refused(const std::string& words, const std::function<void(const fs::path&)>& damage) {
    const TemporaryFolder folder;
    const fs::path source = folder.path / "source";
    fs::copy(Source::one().folder.path / "source", source, fs::copy_options::recursive);
    damage(source);
    CHECK_FAULT(import_vhap(options(source, folder.path / "out")), words);
    CHECK(!fs::exists(folder.path / "out" / "capture.json"));
}

void edit_json(const fs::path& path, const std::function<void(nlohmann::json&)>& edit) {
    nlohmann::json json = read_json(path);
    edit(json);
    std::ofstream(path) << json;
}

} // namespace

TEST_CASE("vhap: gaze, landmarks, eyes and cameras are those of the scene") {
    const TemporaryFolder folder;
    const Source& source = Source::one();
    const ImportSummary summary =
        import_vhap(options(source.folder.path / "source", folder.path / "out"));
    CHECK(summary.frames == source.truth.capture.frame_count());
    CHECK(summary.written == summary.frames);
    const Capture got = read_trainable_capture(folder.path / "out");
    const Capture& truth = source.truth.capture;
    const Comparison c = compare(truth, got);
    INFO(c.text());
    CHECK(c.gaze_deg < 0.01);
    CHECK(c.landmarks < 1e-4);
    CHECK(c.centres < 2e-3);
    CHECK(c.projection_px < 1e-3);
    CHECK(c.mask_difference == 0);
    CHECK(c.eye_overlap > 0.8);
    CHECK(got.test.size() == truth.test.size());
    CHECK(got.expression_width() == 103);
    CHECK(got.frames[0].eyes[0].radius.value() ==
          doctest::Approx(*truth.frames[0].eyes[0].radius).epsilon(0.05));
    const nlohmann::json json = read_json(folder.path / "out" / "capture.json");
    CHECK(json.at("import").at("kind") == "vhap");
    CHECK(json.at("import").at("derived").size() >= 3);
}

TEST_CASE("vhap: an interrupted import goes on, and repeats no complete frame") {
    const TemporaryFolder folder;
    const Source& source = Source::one();
    const fs::path out = folder.path / "out";
    ImportOptions o = options(source.folder.path / "source", out);
    struct Stop {};
    o.progress = [](int done, int) {
        if (done == 2) throw Stop();
    };
    CHECK_THROWS_AS(import_vhap(o), Stop);
    CHECK(!fs::exists(out / "capture.json"));
    const fs::path first = out / "images" / "00000" / "image_00.png";
    const auto when = fs::last_write_time(first);
    o.progress = [](int, int) {};
    const ImportSummary rest = import_vhap(o);
    CHECK(rest.written == rest.frames - 2);
    CHECK(fs::last_write_time(first) == when);
    CHECK(import_vhap(o).written == 0);
    CHECK_NOTHROW(read_trainable_capture(out));

    o.eyeballs = {3931, 4470, 4477, 5022};
    CHECK_FAULT(import_vhap(o),
                "import.json: eyeballs was [3931,4476,4477,5022] in the import "
                "that began this folder, and is [3931,4470,4477,5022] now");
    const fs::path other = folder.path / "other";
    fs::create_directories(other);
    std::ofstream(other / "mine.txt") << "x";
    CHECK_FAULT(import_vhap(options(o.source, other)),
                "other: exists already and was not begun by `rye import`");
}

TEST_CASE("vhap: wrong sources are refused by file, field and value") {
    check_refused("transforms.json: no such file, expected the export folder of VHAP",
                  [](const fs::path& s) { fs::remove(s / "transforms.json"); });
    check_refused("transforms.json: frame 1: timestep_index: got -1, expected a whole number",
                  [](const fs::path& s) {
                      edit_json(s / "transforms.json", [](nlohmann::json& j) {
                          j.at("frames").at(1).at("timestep_index") = -1;
                      });
                  });
    for (const char* key : {"file_path", "fg_mask_path", "mesh_path", "flame_param_path"})
        check_refused("transforms.json: frame 1: " + std::string(key) +
                          ": got '../other/x.png', which is outside ",
                      [&](const fs::path& s) {
                          edit_json(s / "transforms.json", [&](nlohmann::json& j) {
                              j.at("frames").at(1)[key] = "../other/x.png";
                          });
                      });
    check_refused("meshes/00001.obj: no such file: landmarks and eyes come from the meshes; export "
                  "once more into the same folder with VHAP's `--flame-mode mesh "
                  "--no-create-mask-from-mesh`",
                  [](const fs::path& s) { fs::remove(s / "meshes/00001.obj"); });
    check_refused("meshes/00000.obj: got 4 vertices, expected FLAME's 5023, or 5143",
                  [](const fs::path& s) {
                      std::ofstream(s / "meshes/00000.obj")
                          << "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n";
                  });
    check_refused("flame_param/00002.npz: eyes_pose: got shape (3,), expected 6 numbers",
                  [](const fs::path& s) {
                      const fs::path file = s / "flame_param/00002.npz";
                      NpzArrays arrays = read_npz(file);
                      const std::vector<float> three(3, 0.0f);
                      arrays["eyes_pose"] = npy_array<float>({3}, std::span<const float>(three));
                      write_npz(file, arrays);
                  });
    check_refused("flame_param/00001.npz: expr: value 4 is nan, expected a finite number",
                  [](const fs::path& s) {
                      const fs::path file = s / "flame_param/00001.npz";
                      NpzArrays arrays = read_npz(file);
                      std::vector<double> v = arrays["expr"].values<double>("expr");
                      v[4] = std::nan("");
                      arrays["expr"] = npy_array<double>({1, 100}, std::span<const double>(v));
                      write_npz(file, arrays);
                  });
    check_refused("meshes/00002.obj: the head is turned by ", [](const fs::path& s) {
        const fs::path file = s / "flame_param/00002.npz";
        NpzArrays arrays = read_npz(file);
        const std::vector<float> turned{0, 1, 0};
        arrays["rotation"] = npy_array<float>({1, 3}, std::span<const float>(turned));
        write_npz(file, arrays);
    });
    check_refused(
        "images/00000_00.png: got 16 x 16 pixels, expected 160 x 160", [](const fs::path& s) {
            write_png(s / "images/00000_00.png", Image8{16, 16, 1, std::vector<std::uint8_t>(256)});
        });
    check_refused("meshes/00000.obj: line 3: got the coordinate 'x', expected a finite number",
                  [](const fs::path& s) {
                      std::ofstream(s / "meshes/00000.obj") << "# one\nv 0 0 0\nv 1 x 0\n";
                  });
}
