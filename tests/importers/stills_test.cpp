// SPDX-License-Identifier: Apache-2.0
// Kinds colmap and transforms. With RYE_DATA set to a folder with buddha, its photographs are
// imported both ways and must agree.
#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <string>

#include <doctest/doctest.h>

#include <rye/io/npz.hpp>

#include "../support/hostile.hpp"
#include "../support/real_data.hpp"
#include "comparison.hpp"
#include "data/json.hpp"
#include "data/photographs.hpp"
#include "data/validate.hpp"
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
        s.train_frames = 1;
        s.novel_frames = 0;
        truth = true_scene(folder.path / "truth", s);
        write_transforms_source(truth, folder.path / "transforms", false);
        write_transforms_source(truth, folder.path / "transforms_lens", true);
        write_blender_source(truth, folder.path / "blender");
        write_colmap_source(truth, folder.path / "colmap", ColmapFiles::binary, false);
        write_colmap_source(truth, folder.path / "colmap_lens", ColmapFiles::binary, true);
        write_colmap_source(truth, folder.path / "text", ColmapFiles::text, false);
        write_colmap_source(truth, folder.path / "text_lens", ColmapFiles::text, true);
    }
    static const Source& one() {
        static const Source source;
        return source;
    }
};

ImportSummary import(const std::string& kind, const fs::path& source, const fs::path& out) {
    ImportOptions o;
    o.source = source;
    o.out = out;
    return kind == "transforms" ? import_transforms(o) : import_colmap(o);
}

/// Largest differences of the imported cameras from the true ones, in order.
double camera_difference(const Capture& truth, const fs::path& out) {
    double most = 0;
    int k = 0;
    const nlohmann::json description = read_json(out / "capture.json");
    for (const auto& id : description.at("camera_ids")) {
        const NpzArrays a =
            read_npz(out / "cameras/0000" / ("camera_" + id.get<std::string>() + ".npz"));
        const Pinhole<double>& c = truth.camera(0, k++);
        const std::vector<double> in = a.at("intrinsic").values<double>("intrinsic");
        for (const auto& [got, expected] :
             {std::pair{in[0], c.fx}, {in[4], c.fy}, {in[2], c.cx}, {in[5], c.cy}})
            most = std::max(most, std::abs(got - expected));
        const std::vector<double> ex = a.at("extrinsic").values<double>("extrinsic");
        for (Index r = 0; r < 3; ++r) {
            for (Index j = 0; j < 3; ++j)
                most = std::max(most, std::abs(ex[static_cast<std::size_t>(4 * r + j)] -
                                               c.camera_from_world.rotation(r, j)));
            most = std::max(most, std::abs(ex[static_cast<std::size_t>(4 * r + 3)] -
                                           c.camera_from_world.translation[r]));
        }
    }
    CHECK(k == truth.camera_count());
    return most;
}

void check_refused(const std::string& kind, const std::string& from, const std::string& words,
                   const std::function<void(const fs::path&)>& damage) {
    const TemporaryFolder folder;
    const fs::path source = folder.path / "source";
    fs::copy(Source::one().folder.path / from, source, fs::copy_options::recursive);
    damage(source);
    CHECK_FAULT(import(kind, source, folder.path / "out"), words);
    CHECK(!fs::exists(folder.path / "out" / "capture.json"));
}

void replace_in(const fs::path& path, const std::string& old, const std::string& now) {
    const Bytes bytes = read_file(path);
    std::string text(as_text(bytes));
    REQUIRE(text.find(old) != std::string::npos);
    text.replace(text.find(old), old.size(), now);
    std::ofstream(path, std::ios::binary) << text;
}

template <class T>
void put(const fs::path& path, std::size_t at, T value) {
    Bytes bytes = read_file(path);
    REQUIRE(bytes.size() >= at + sizeof value);
    std::memcpy(bytes.data() + at, &value, sizeof value);
    write_atomic(path, bytes, Durability::atomic_only);
}

void edit_json(const fs::path& path, const std::function<void(nlohmann::json&)>& edit) {
    nlohmann::json json = read_json(path);
    edit(json);
    std::ofstream(path) << json;
}

} // namespace

TEST_CASE("stills: cameras and pictures of each layout are those of the scene") {
    const Source& source = Source::one();
    const Capture& truth = source.truth.capture;
    for (const std::string name : {"transforms", "colmap", "text"}) {
        CAPTURE(name);
        const TemporaryFolder folder;
        const std::string kind = name == "transforms" ? name : "colmap";
        const fs::path out = folder.path / "out";
        const ImportSummary summary = import(kind, source.folder.path / name, out);
        CHECK(summary.cameras == truth.camera_count());
        CHECK(camera_difference(truth, out) < 1e-9);
        // Without a lens the bytes of the pictures are kept.
        CHECK(read_file(out / "images/0000/image_photo_01.png") ==
              read_file(source.folder.path / name / "images/photo_01.png"));
        CHECK(fs::exists(out / "images/0000/mask_photo_01.png") == (name == "transforms"));
        CHECK_FAULT(read_trainable_capture(out), "params: no such folder");
        const std::vector<Photograph> again = read_photographs(out / "transforms.json");
        REQUIRE(again.size() == 3);
        CHECK(fs::exists(out / again[2].file));
        CHECK((again[2].camera.centre() - truth.camera(0, 2).centre()).norm() < 1e-9);
        CHECK(!summary.has_head);
        CHECK(import(kind, source.folder.path / name, out).written == 0);
    }
}

TEST_CASE("stills: Blender's layout: three lists, no sizes, names without ending, alpha") {
    const Source& source = Source::one();
    const TemporaryFolder folder;
    const fs::path out = folder.path / "out";
    const ImportSummary summary = import("transforms", source.folder.path / "blender", out);
    CHECK(summary.cameras == 3);
    CHECK(summary.found.front() == "3 pictures and cameras, 3 masks");
    CHECK(read_json(out / "capture.json").at("camera_ids") ==
          nlohmann::json{"train_r_0", "val_r_0", "test_r_0"});
    // One focal length, and a principal point in the middle, are all that the layout has.
    const std::vector<Photograph> cameras = read_photographs(out / "transforms.json");
    REQUIRE(cameras.size() == 3);
    for (int k = 0; k < 3; ++k) {
        const Pinhole<double>& got = cameras[static_cast<std::size_t>(k)].camera;
        const Pinhole<double>& expected = source.truth.capture.camera(0, k);
        CHECK(got.fx == doctest::Approx(expected.fx));
        CHECK(got.fy == got.fx);
        CHECK(got.cx == 0.5 * got.width);
        CHECK(got.cy == 0.5 * got.height);
        CHECK((got.centre() - expected.centre()).norm() < 1e-9);
        CHECK((got.camera_from_world.rotation - expected.camera_from_world.rotation).norm() < 1e-9);
    }
    for (const std::string part : {"train", "val", "test"}) {
        const Image8 raw = read_image8(source.folder.path / "blender" / part / "r_0.png");
        const Image8 got =
            read_image8(out / "images/0000" / ("image_" + part + "_r_0.png"), 3);
        const Image8 mask = read_image8(out / "images/0000" / ("mask_" + part + "_r_0.png"));
        REQUIRE(raw.channels == 4);
        REQUIRE(mask.values.size() * 4 == raw.values.size());
        bool same = true;
        for (std::size_t i = 0; i < mask.values.size(); ++i)
            same = same && mask.values[i] == raw.values[4 * i + 3] &&
                   got.values[3 * i] == raw.values[4 * i];
        CHECK(same);
    }
    // One of the lists is a source as well.
    const fs::path one = folder.path / "one";
    CHECK(import("transforms", source.folder.path / "blender/transforms_val.json", one).cameras ==
          1);
    check_refused("transforms", "blender", "train/r_0: no such file, named by file_path of",
                  [](const fs::path& s) { fs::remove(s / "train/r_0.png"); });
    check_refused("transforms", "blender", "transforms_test.json: frame 0: transform_matrix: is "
                                           "missing, expected 4 rows of 4 numbers",
                  [](const fs::path& s) {
                      edit_json(s / "transforms_test.json", [](nlohmann::json& j) {
                          j.at("frames").at(0).erase("transform_matrix");
                      });
                  });
}

TEST_CASE("stills: a lens is straightened") {
    const Source& source = Source::one();
    const Capture& truth = source.truth.capture;
    for (const std::string name : {"transforms_lens", "colmap_lens", "text_lens"}) {
        CAPTURE(name);
        const TemporaryFolder folder;
        const fs::path out = folder.path / "out";
        const ImportSummary summary = import(name == "transforms_lens" ? "transforms" : "colmap",
                                             source.folder.path / name, out);
        CHECK(camera_difference(truth, out) < 1e-9);
        CHECK(summary.derived.front() == "3 pictures straightened from their lens to pinholes");
        double straight = 0, bent = 0, n = 0;
        const Image8 got = read_image8(out / "images/0000/image_photo_00.png", 3);
        const Image8 seen = read_image8(out / "images/0000/visible_photo_00.png", 1);
        const Image8 raw = read_image8(source.folder.path / name / "images/photo_00.png", 3);
        const Image8 expected =
            read_image8(source.folder.path / "transforms/images/photo_00.png", 3);
        for (std::size_t i = 0; i < got.values.size(); ++i) {
            if (seen.values[i / 3] == 0) continue;
            const auto off = [&](const Image8& a) {
                return std::abs(double(a.values[i]) - double(expected.values[i]));
            };
            straight += off(got);
            bent += off(raw);
            ++n;
        }
        INFO("mean differences of 255: straightened ", straight / n, ", as photographed ",
             bent / n);
        CHECK(n > 0.9 * static_cast<double>(got.values.size()));
        CHECK(straight < 0.4 * bent);
    }
}

TEST_CASE("stills: smaller photographs are extended, and visible marks what they lack") {
    const TemporaryFolder folder;
    const fs::path source = folder.path / "source", out = folder.path / "out";
    fs::copy(Source::one().folder.path / "transforms", source, fs::copy_options::recursive);
    const Image8 small{100, 90, 3, std::vector<std::uint8_t>(100 * 90 * 3, 77)};
    write_png(source / "images/photo_02.png", small);
    edit_json(source / "transforms.json", [](nlohmann::json& j) {
        nlohmann::json& frame = j.at("frames").at(2);
        frame["w"] = 100;
        frame["h"] = 90;
        frame["cx"] = 50;
        frame["cy"] = 45;
        frame.erase("mask_path");
    });
    const ImportSummary summary = import("transforms", source, out);
    CHECK(summary.derived.front() == "1 pictures extended to 160 x 160 pixels (`visible`)");
    const Image8 picture = read_image8(out / "images/0000/image_photo_02.png");
    const Image8 seen = read_image8(out / "images/0000/visible_photo_02.png");
    CHECK(picture.width == 160);
    CHECK(picture.values[0] == 77);
    CHECK(seen.values[99] == 255);
    CHECK(seen.values[100] == 0);
    CHECK(seen.values[90 * 160] == 0);
}

TEST_CASE("transforms: wrong sources are refused by file, field and value") {
    const auto refused = [](const std::string& words, auto&& damage) {
        check_refused("transforms", "transforms", words, damage);
    };
    const auto edited = [&](const std::string& words, auto&& edit) {
        refused(words, [&](const fs::path& s) { edit_json(s / "transforms.json", edit); });
    };
    refused("transforms.json: no such file, expected transforms.json of photographs",
            [](const fs::path& s) { fs::remove(s / "transforms.json"); });
    edited("transforms.json: frames: is missing or empty",
           [](nlohmann::json& j) { j.erase("frames"); });
    edited("transforms.json: frame 1: camera_model: got EQUIRECTANGULAR, expected OPENCV",
           [](nlohmann::json& j) { j.at("frames").at(1)["camera_model"] = "EQUIRECTANGULAR"; });
    edited("transforms.json: frame 0: fl_x and fl_y: got -5.0",
           [](nlohmann::json& j) { j.at("frames").at(0)["fl_x"] = -5; });
    edited("transforms.json: frame 2: transform_matrix: its 3 x 3 part is not a rotation",
           [](nlohmann::json& j) { j.at("frames").at(2).at("transform_matrix").at(0).at(0) = 3; });
    edited("transforms.json: frame 0: k1: got \"none\", expected a finite number",
           [](nlohmann::json& j) { j["k1"] = "none"; });
    edited("transforms.json: frame 1: transform_matrix: is missing, expected 4 rows of 4 numbers",
           [](nlohmann::json& j) { j.at("frames").at(1).erase("transform_matrix"); });
    refused("images/photo_01.png: no such file, named by file_path",
            [](const fs::path& s) { fs::remove(s / "images/photo_01.png"); });
    refused(
        "images/photo_00.png: got 8 x 8 pixels, expected 160 x 160 as its camera has",
        [](const fs::path& s) {
            write_png(s / "images/photo_00.png", Image8{8, 8, 1, std::vector<std::uint8_t>(64)});
        });
}

TEST_CASE("colmap: wrong sources are refused by file, field and value") {
    const auto refused = [](const std::string& words, auto&& damage) {
        check_refused("colmap", "colmap", words, damage);
    };
    const auto text = [](const std::string& words, auto&& damage) {
        check_refused("colmap", "text", words, damage);
    };
    refused("has no cameras.bin and images.bin, nor .txt",
            [](const fs::path& s) { fs::remove(s / "sparse/0/images.bin"); });
    refused("cameras.bin: camera 1: model: got OPENCV_FISHEYE, expected SIMPLE_PINHOLE",
            [](const fs::path& s) {
                // The parameters of the others follow, so that the file is long enough.
                put(s / "sparse/0/cameras.bin", 12, std::int32_t(5));
            });
    refused("cameras.bin: the number of cameras: got 99, expected at most",
            [](const fs::path& s) { put(s / "sparse/0/cameras.bin", 0, std::uint64_t(99)); });
    refused("images.bin: truncated: a picture's points", [](const fs::path& s) {
        fs::resize_file(s / "sparse/0/images.bin", fs::file_size(s / "sparse/0/images.bin") - 4);
    });
    refused("images.bin: photo_00.png: got the camera 77, expected one of the 3",
            [](const fs::path& s) { put(s / "sparse/0/images.bin", 8 + 60, std::uint32_t(77)); });
    refused("images.bin: image 101: pose: number 4 is nan, expected a finite number",
            [](const fs::path& s) { put(s / "sparse/0/images.bin", 8 + 36, std::nan("")); });
    refused("images/photo_02.png: no such file, expected the picture 'photo_02.png'",
            [](const fs::path& s) { fs::remove(s / "images/photo_02.png"); });
    text("cameras.txt: line 2: model: got 'PINHOL', expected SIMPLE_PINHOLE",
         [](const fs::path& s) { replace_in(s / "sparse/0/cameras.txt", "PINHOLE", "PINHOL"); });
    text("cameras.txt: line 3: WIDTH: got 'x160', expected a finite number", [](const fs::path& s) {
        replace_in(s / "sparse/0/cameras.txt", "2 PINHOLE 160", "2 PINHOLE x160");
    });
}

TEST_CASE("stills: a picture outside the folder of its source is taken only if that is asked for") {
    const TemporaryFolder folder;
    const fs::path outside = folder.path / "photo_01.png";
    fs::copy(Source::one().folder.path / "transforms/images/photo_01.png", outside);
    int number = 0;
    const auto check = [&](const char* kind, const char* from, const std::string& words,
                           const std::function<void(const fs::path&)>& edit) {
        const fs::path source = folder.path / ("source" + std::to_string(number));
        fs::copy(Source::one().folder.path / from, source, fs::copy_options::recursive);
        edit(source);
        ImportOptions o;
        o.source = source;
        o.out = folder.path / ("out" + std::to_string(number++));
        const auto run = [&] {
            return std::string(kind) == "colmap" ? import_colmap(o) : import_transforms(o);
        };
        CHECK_FAULT(run(), words + " is outside " + source.string() +
                               ", expected a file in that folder; --allow-outside takes others");
        CHECK(!fs::exists(o.out));
        o.allow_outside = true;
        CHECK(run().cameras == 3);
    };
    const auto path = [](const char* key, const std::string& name) {
        return [=](const fs::path& s) {
            edit_json(s / "transforms.json",
                      [&](nlohmann::json& j) { j.at("frames").at(1)[key] = name; });
        };
    };
    for (const std::string& name : {std::string("../photo_01.png"), outside.string(),
                                    std::string("images/../../photo_01.png")}) {
        check("transforms", "transforms",
              "transforms.json: frame 1: file_path: got '" + name + "', which",
              path("file_path", name));
        check("transforms", "transforms",
              "transforms.json: frame 1: mask_path: got '" + name + "', which",
              path("mask_path", name));
    }
    check("colmap", "text", "the picture '../../photo_01.png': got 'images/../../photo_01.png', which",
          [](const fs::path& s) {
              replace_in(s / "sparse/0/images.txt", "photo_01.png", "../../photo_01.png");
          });
    // A name with ".." that stays inside is as good as any.
    const fs::path source = folder.path / "inside";
    fs::copy(Source::one().folder.path / "transforms", source, fs::copy_options::recursive);
    path("file_path", "images/../images/photo_01.png")(source);
    ImportOptions o;
    o.source = source;
    o.out = folder.path / "out";
    CHECK(import_transforms(o).cameras == 3);
}

TEST_CASE("colmap: any damage of a model is an Error or a result") {
    const TemporaryFolder folder;
    const fs::path source = folder.path / "source";
    fs::copy(Source::one().folder.path / "colmap_lens", source, fs::copy_options::recursive);
    std::uint32_t random = 1;
    int faults = 0, results = 0;
    for (const char* name : {"cameras.bin", "images.bin"}) {
        const fs::path file = source / "sparse/0" / name;
        const Bytes whole = read_file(file);
        for (int trial = 0; trial < 60; ++trial) {
            random = random * 1664525U + 1013904223U;
            Bytes bytes = whole;
            const std::size_t at = (random >> 8U) % bytes.size();
            if (trial % 2 == 0)
                bytes.resize(at);
            else
                bytes[at] = static_cast<std::byte>(random >> 3U);
            write_atomic(file, bytes, Durability::atomic_only);
            try {
                import("colmap", source, folder.path / ("out" + std::to_string(results)));
                ++results;
            } catch (const Error&) {
                ++faults;
            }
        }
        write_atomic(file, whole, Durability::atomic_only);
    }
    CHECK(faults > 60);
    CHECK(faults + results == 120);
}

TEST_CASE("stills: real photographs, as transforms.json and as a COLMAP model") {
    const auto folder = test::real_data("buddha");
    if (!folder) return;
    const TemporaryFolder outs;
    import("transforms", *folder, outs.path / "a");
    const ImportSummary summary = import("colmap", *folder, outs.path / "b");
    CHECK(summary.cameras == 13);
    for (const auto& entry : fs::directory_iterator(outs.path / "a" / "cameras/0000")) {
        const NpzArrays a = read_npz(entry.path());
        const NpzArrays b = read_npz(outs.path / "b" / "cameras/0000" / entry.path().filename());
        const auto of = [](const NpzArrays& file, const char* name) {
            return file.at(name).values<double>(name);
        };
        for (std::size_t i = 0; i < 12; ++i)
            CHECK(of(a, "extrinsic")[i] == doctest::Approx(of(b, "extrinsic")[i]).epsilon(1e-5));
        for (std::size_t i = 0; i < 9; ++i)
            CHECK(of(a, "intrinsic")[i] == doctest::Approx(of(b, "intrinsic")[i]).epsilon(1e-5));
    }
}
