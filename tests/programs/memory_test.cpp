// SPDX-License-Identifier: Apache-2.0
// What a small file may ask of the program: JSON texts, pictures, tables and lists of cameras.
#include <string>

#include <doctest/doctest.h>

#include <rye/avatar/drivers.hpp>
#include <rye/core/memory.hpp>
#include <rye/geometry/camera.hpp>

#include "../support/hostile.hpp"
#include "data/driver_table.hpp"
#include "data/json.hpp"
#include "data/memory_limit.hpp"
#include "data/picture.hpp"
#include "importers/colmap_model.hpp"
#include "importers/gaze_file.hpp"
#include "model/types.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

/// The limit of the program, in this scope.
struct Limit {
    explicit Limit(std::uint64_t bytes) { set_memory_limit(bytes); }
    Limit(const Limit&) = delete;
    Limit& operator=(const Limit&) = delete;
    ~Limit() { set_memory_limit(default_memory); }
};

/// `first`, then `item` again and again up to so many bytes, then `last`.
std::string repeated(const std::string& first, const std::string& item, std::size_t bytes,
                     const std::string& last) {
    std::string text = first;
    while (text.size() < bytes) text += item;
    return text + last;
}

} // namespace

TEST_CASE("memory: a JSON text of 20 MB that would take a gigabyte is refused") {
    const std::string list = repeated("{\"frames\":[0", ",0", 20'000'000, "]}");
    CHECK_FAULT(parse_json_text(list, "capture.json"),
                "capture.json: its values to here would take 2684");
    CHECK_FAULT(parse_json_text(list, "capture.json"),
                "bytes of memory, expected at most the limit of 268435456");
    const std::string lists = repeated("[[]", ",[]", 20'000'000, "]");
    CHECK_FAULT(parse_json_text<nlohmann::ordered_json>(lists, "lists.json"), "limit of 268435456");
    std::string members = "{\"a\":0";
    for (int i = 0; members.size() < 30'000'000; ++i) members += ",\"" + std::to_string(i) + "\":0";
    CHECK_FAULT(parse_json_text(members + "}", "members.json"), "limit of 268435456");
    // Of ordinary size it is read, and faults are named as before.
    CHECK(parse_json_text(repeated("[0", ",0", 100'000, "]"), "a").size() > 40'000);
    CHECK_FAULT(parse_json_text("[0,", "a.json"), "a.json: not JSON: ");
    const Limit small(1 << 20U);
    CHECK_FAULT(parse_json_text(repeated("[0", ",0", 100'000, "]"), "a.json"), "limit of 131072");
}

TEST_CASE("memory: a picture of few bytes and many pixels is refused before it is decoded") {
    const TemporaryFolder folder;
    Image8 image{3000, 2000, 1, std::vector<std::uint8_t>(6'000'000)};
    write_png(folder.path / "a.png", image);
    write_jpeg(folder.path / "a.jpg", image, 50);
    const Limit small(16 << 20U);
    for (const char* name : {"a.png", "a.jpg"}) {
        CHECK(read_image_header(folder.path / name).width == 3000);
        CHECK_FAULT(read_image8(folder.path / name),
                    std::string(name) + ": its 3000 x 2000 pixels would take 36000000 bytes of "
                                        "memory, expected at most the limit of 16777216");
        CHECK_FAULT(read_image8(folder.path / name, 3), "pixels would take 96000000 bytes");
    }
    set_memory_limit(36'000'000);
    CHECK(read_image8(folder.path / "a.png").width == 3000);
}

TEST_CASE("memory: tables of short lines") {
    const Limit small(4 << 20U);
    Drivers<float> usual;
    usual.expression = VecX<float>::Zero(50);
    usual.scale = 1;
    for (auto& gaze : usual.gaze) gaze = Vec3<float>(0, 0, 1);
    const std::string table = repeated("scale\n", "1\n", 100'000, "");
    CHECK_FAULT(parse_drivers(table, "small.csv", {50, {}}, usual), "small.csv: line ");
    CHECK_FAULT(parse_drivers(table, "small.csv", {50, {}}, usual),
                "bytes of memory, expected at most the limit of 4194304");
    const std::string lines(200'000, '\n');
    CHECK_FAULT(parse_colmap_pictures(as_bytes(lines), ColmapFormat::text, "images.txt"),
                "limit of 4194304");
    std::string gazes = "frame,left_pitch,left_yaw,right_pitch,right_yaw\n";
    for (int i = 0; i < 60'000; ++i) gazes += std::to_string(i) + ",0,0,0,0\n";
    CHECK_FAULT(parse_gaze_csv(gazes, "gaze.csv"), "limit of 4194304");
}

TEST_CASE("memory: lists of a run's pictures") {
    const Limit small(2 << 20U);
    const Index count = 400;
    Gaussians<float> wide(count, 3);
    wide.mean.setZero();
    wide.rotation = Vec4<float>(1, 0, 0, 0).replicate(1, count);
    wide.scale.setConstant(10);
    wide.opacity.setConstant(0.5F);
    wide.feature.setZero();
    const auto camera = look_at<float>({0, 0, 4}, {0, 0, 0}, {0, 1, 0}, 0.5F, {512, 512});
    const VecX<float> white = VecX<float>::Ones(3);
    CHECK_FAULT(train_rasterizer().forward(train_backend(), wide, camera, white),
                "expected at most the limit of 2097152");
    set_memory_limit(default_memory);
    CHECK(train_rasterizer().forward(train_backend(), wide, camera, white).feature.width == 512);
}
