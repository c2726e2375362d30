// SPDX-License-Identifier: Apache-2.0
// Gaussians of glTF files: what glb.hpp writes comes back; files written down here with node
// transforms, several primitives, every permitted type of number, strides, buffers in data: URIs
// and in files; wrong files by their messages.
#include <rye/io/gltf.hpp>

#include <cstring>

#include <doctest/doctest.h>

#include <rye/io/atomic_file.hpp>
#include <rye/io/splats.hpp>

#include "../support/clouds.hpp"
#include "../support/hostile.hpp"

using namespace rye;
using test::cloud_of, test::largest, test::largest_turn, test::opacities;

namespace {

/// A file of one Gaussian in an external buffer, whose parts tests replace.
struct Written {
    std::string nodes = R"([{"mesh":0}])", further, extension, primitive = R"(,"mode":0)";
    std::map<std::string, std::string> accessors{
        {"POSITION", R"("bufferView":0,"componentType":5126,"count":1,"type":"VEC3")"},
        {"ROTATION",
         R"("bufferView":0,"byteOffset":12,"componentType":5126,"count":1,"type":"VEC4")"},
        {"SCALE", R"("bufferView":0,"byteOffset":28,"componentType":5126,"count":1,"type":"VEC3")"},
        {"OPACITY",
         R"("bufferView":0,"byteOffset":40,"componentType":5126,"count":1,"type":"SCALAR")"},
        {"SH_DEGREE_0_COEF_0",
         R"("bufferView":0,"byteOffset":44,"componentType":5126,"count":1,"type":"VEC3")"}};
    std::string view = R"("buffer":0,"byteLength":56)";
    std::string buffer = R"("uri":"some%20data.bin","byteLength":56)";
    std::vector<float> numbers{1, 2, 3, 0, 0, 0, 1, 0.5F, 1, 2, 0.25F, 0.1F, 0.2F, 0.3F};

    std::string text() const {
        std::string attributes, list;
        int index = 0;
        for (const auto& [name, accessor] : accessors) {
            const std::string comma = index == 0 ? "" : ",";
            attributes += comma + "\"" + (name == "POSITION" ? "" : "KHR_gaussian_splatting:") +
                          name + "\":" + std::to_string(index++);
            list += comma + "{" + accessor + "}";
        }
        return R"({"asset":{"version":"2.0"},"nodes":)" + nodes + R"(,"meshes":[{"primitives":[)" +
               R"({"attributes":{)" + attributes + "}" + primitive +
               R"(,"extensions":{"KHR_gaussian_splatting":{)" +
               (extension.empty() ? R"("kernel":"ellipse","colorSpace":"srgb_rec709_display")"
                                  : extension) +
               R"(}}}]}],"accessors":[)" + list + R"(],"bufferViews":[{)" + view +
               R"(}],"buffers":[{)" + buffer + "}]" + further + "}";
    }
    GaussianCloud<double> read() const {
        const auto outside = [&](const std::string& uri, std::uint64_t, const std::string&) {
            CHECK(uri == "some data.bin");
            const ByteSpan span = std::as_bytes(std::span(numbers));
            return Bytes(span.begin(), span.end());
        };
        return parse_gltf<double>(as_bytes(text()), "some.gltf", default_memory, outside);
    }
};

std::string accessor(int component, bool normalized, const char* type, int count = 1) {
    return R"("bufferView":0,"componentType":)" + std::to_string(component) +
           (normalized ? R"(,"normalized":true)" : "") + R"(,"count":)" + std::to_string(count) +
           R"(,"type":")" + type + "\"";
}

/// Replaces the first numbers of the buffer.
template <class N>
void put(Written& w, std::initializer_list<N> numbers) {
    std::memcpy(w.numbers.data(), std::data(numbers), sizeof(N) * numbers.size());
}

} // namespace

TEST_CASE("gltf: what glb.hpp writes is read back as floats hold it, at every degree") {
    for (int degree = 0; degree <= 3; ++degree) {
        const auto c = cloud_of(50, degree);
        const auto back = parse_gltf<double>(glb_bytes(c), "a");
        REQUIRE(back.count() == 50);
        REQUIRE(back.degree() == degree);
        CHECK(largest(back.mean - c.mean) <= 30.0 / (1 << 24));
        CHECK(largest(back.log_scale - c.log_scale) <= 1e-6);
        CHECK(largest(back.sh_constant - c.sh_constant) <= 1e-6);
        CHECK(largest(back.sh_rest - c.sh_rest) <= 1e-7);
        CHECK(largest(opacities(back) - opacities(c)) <= 1e-7);
        CHECK(largest_turn(back, c) <= 1e-4);
    }
}

TEST_CASE("gltf: a Gaussian as written down, in the axes of a PLY") {
    const auto c = Written().read();
    REQUIRE(c.count() == 1);
    CHECK(c.degree() == 0);
    CHECK(c.mean == Vec3<double>(1, -2, -3));
    CHECK(c.rotation == Quat<double>(1, 0, 0, 0));
    CHECK(largest(c.log_scale - Vec3<double>(std::log(0.5), 0, std::log(2))) <= 1e-12);
    CHECK(opacities(c)(0, 0) == doctest::Approx(0.25));
    CHECK(c.sh_constant(1, 0) == doctest::Approx(0.2));
}

TEST_CASE("gltf: a quaternion of another length is normalised") {
    Written w;
    w.numbers[3] = 3;
    w.numbers[6] = 4;
    CHECK(largest(w.read().rotation - Quat<double>(0.8, 0.6, 0, 0)) <= 1e-12);
}

TEST_CASE("gltf: transforms of nodes move, turn and scale, parents before children") {
    Written w;
    // Scaled by 2, then a quarter turn about z (x to y), then moved.
    w.nodes = R"([{"children":[1],"translation":[10,0,0]},)"
              R"({"mesh":0,"rotation":[0,0,0.7071067811865476,0.7071067811865476],)"
              R"("scale":[2,2,2]}])";
    auto c = w.read();
    REQUIRE(c.count() == 1);
    CHECK(largest(c.mean - Vec3<double>(10 - 4, -2, -6)) <= 1e-12);
    CHECK(c.log_scale(2, 0) == doctest::Approx(std::log(4)));
    // A turn about z becomes the opposite one where z points away.
    CHECK(c.rotation(3, 0) == doctest::Approx(-0.70710678));
    w.nodes = R"([{"mesh":0,"matrix":[0,2,0,0,-2,0,0,0,0,0,2,0,10,0,0,1]}])";
    CHECK(largest(w.read().mean - c.mean) <= 1e-12);
    // A scene, of which the other node is no part; the same mesh twice.
    w.nodes = R"([{"mesh":0},{"mesh":0,"translation":[0,1,0]},{"mesh":0}])";
    w.further = R"(,"scenes":[{"nodes":[]},{"nodes":[1,2]}],"scene":1)";
    c = w.read();
    REQUIRE(c.count() == 2);
    CHECK(c.mean.col(0) == Vec3<double>(1, -3, -3));
    CHECK(c.mean.col(1) == Vec3<double>(1, -2, -3));
}

TEST_CASE("gltf: every type of number that the extension permits, normalised or not") {
    const auto turned = [](Written w, int component) {
        w.accessors["ROTATION"] = accessor(component, true, "VEC4");
        return Quat<double>(w.read().rotation.col(0));
    };
    Written w;
    put<std::int8_t>(w, {0, 127, 0, -128}); // -128 is -1 too
    CHECK(largest(turned(w, 5120) - Quat<double>(-1, 0, -1, 0).normalized()) <= 1e-12);
    put<std::int16_t>(w, {32767, 0, 0, 0});
    CHECK(largest(turned(w, 5122) - Quat<double>(0, 1, 0, 0)) <= 1e-12);
    const auto scaled = [](Written v, int component, bool normalized) {
        v.accessors["SCALE"] = accessor(component, normalized, "VEC3");
        return Vec3<double>(v.read().log_scale.col(0).array().exp());
    };
    put<std::uint8_t>(w, {51, 1, 255, 0});
    CHECK(largest(scaled(w, 5121, true) - Vec3<double>(0.2, 1.0 / 255, 1)) <= 1e-12);
    CHECK(largest(scaled(w, 5121, false) - Vec3<double>(51, 1, 255)) <= 1e-9);
    put<std::uint16_t>(w, {13107, 1, 65535, 0});
    CHECK(largest(scaled(w, 5123, true) - Vec3<double>(0.2, 1.0 / 65535, 1)) <= 1e-12);
    CHECK(largest(scaled(w, 5123, false) - Vec3<double>(13107, 1, 65535)) <= 1e-9);
    w.accessors["OPACITY"] = accessor(5123, true, "SCALAR");
    CHECK(opacities(w.read())(0, 0) == doctest::Approx(0.2));
    // Positions of other types need the extension for them.
    put<std::uint16_t>(w, {1, 2, 3, 0});
    w.accessors["POSITION"] = accessor(5123, false, "VEC3");
    CHECK_FAULT(w.read(),
                "POSITION: accessors[1].componentType is 5123, which the attribute may not");
    w.further = R"(,"extensionsRequired":["KHR_mesh_quantization","KHR_gaussian_splatting"])";
    w.accessors["OPACITY"] = accessor(5121, true, "SCALAR");
    CHECK(w.read().mean == Vec3<double>(1, -2, -3));
    CHECK(opacities(w.read())(0, 0) == doctest::Approx(1.0 / 255));
    w.accessors["SCALE"] = accessor(5120, true, "VEC3");
    CHECK_FAULT(w.read(), "SCALE: accessors[3].componentType is 5120, normalized, which the");
}

TEST_CASE("gltf: interleaved numbers, degrees that differ, and buffers in the text") {
    // Two Gaussians side by side: each of its 56 bytes after the other's.
    Written w;
    for (auto& [name, text] : w.accessors)
        text.replace(text.find(R"("count":1)"), 9, R"("count":2)");
    w.view = R"("buffer":0,"byteLength":112,"byteStride":56)";
    w.buffer = R"("uri":"some%20data.bin","byteLength":112)";
    const std::vector<float> one = w.numbers;
    w.numbers.insert(w.numbers.end(), one.begin(), one.end());
    w.numbers[14] = 7;
    auto c = w.read();
    REQUIRE(c.count() == 2);
    CHECK(c.mean(0, 1) == 7);
    CHECK(c.mean(1, 1) == -2);
    // "AACAPw" is the float 1, without padding.
    w = Written();
    w.buffer = R"("uri":"data:application/octet-stream;base64,AACAPwAAAEAAAEBA)"
               R"(AAAAAAAAAAAAAAAAAACAPwAAAD8AAIA/AAAAQAAAgD7NzMw9zcxMPpqZmT4=","byteLength":56)";
    CHECK(w.read().mean == Vec3<double>(1, -2, -3));
    CHECK(w.read().sh_constant(2, 0) == doctest::Approx(0.3));
    w.buffer.replace(w.buffer.find("AACAPw"), 1, "-");
    CHECK_FAULT(w.read(), "buffers[0]: character 0 of the base64 is none of its digits");
    w.buffer = R"("uri":"data:application/octet-stream;base64,AACAPw==","byteLength":56)";
    CHECK_FAULT(w.read(), "buffers[0]: truncated: byteLength needs bytes 0 to 0 + 56 of 4");
}

TEST_CASE("gltf: a .gltf with a buffer beside it is read from disk") {
    const TemporaryFolder folder;
    const Written w;
    write_atomic(folder.path / "a.gltf", as_bytes(w.text()), Durability::atomic_only);
    CHECK_FAULT(read_splats<double>(folder.path / "a.gltf"), "some data.bin: no such file");
    write_atomic(folder.path / "some data.bin", std::as_bytes(std::span(w.numbers)),
                 Durability::atomic_only);
    CHECK(read_splats<double>(folder.path / "a.gltf").mean == Vec3<double>(1, -2, -3));
}

TEST_CASE("gltf: what is not read is named, with its place and value") {
    const auto fault = [](const auto& change, const std::string& words) {
        Written w;
        change(w);
        CHECK_FAULT(w.read(), words);
        CHECK_FAULT(w.read(), "some.gltf: ");
    };
    using W = Written&;
    fault([](W w) { w.nodes = R"([{"mesh":0,"scale":[1,1,2]}])"; },
          "nodes[0]: its global scale is 1 1 2, expected three equal numbers");
    fault([](W w) { w.nodes = R"([{"mesh":0,"scale":[1,1,-1]}])"; },
          "nodes[0]: its global transform is a mirror");
    fault([](W w) { w.nodes = R"([{"mesh":0,"scale":[0,0,0]}])"; },
          "expected finite numbers above 0");
    fault([](W w) { w.nodes = R"([{"mesh":0,"matrix":[1,0,0,0,0.6,0.8,0,0,0,0,1,0,0,0,0,1]}])"; },
          "nodes[0]: its global transform has a shear");
    fault([](W w) { w.nodes = R"([{"mesh":0,"rotation":[0,0,0,2]}])"; },
          "nodes[0].rotation has the length 2, expected 1");
    fault([](W w) { w.nodes = R"([{"mesh":0,"translation":[0,0]}])"; },
          "nodes[0].translation is [0,0], expected 3 numbers");
    fault([](W w) { w.nodes = R"([{"mesh":3}])"; }, "meshes[3], expected 0 to below 1");
    fault(
        [](W w) {
            w.nodes = R"([{"mesh":0,"children":[1]},{"children":[0]},{}])",
            w.further = R"(,"scenes":[{"nodes":[0]}])";
        },
        "nodes[0] is reached twice, expected a tree of nodes");
    fault([](W w) { w.nodes = R"([{"children":[9]}])"; },
          "nodes[0].children[0] is 9, expected a node");
    fault([](W w) { w.nodes = "[{}]"; }, "no primitive with KHR_gaussian_splatting");
    fault([](W w) { w.primitive = ""; }, "meshes[0].primitives[0].mode is 4, expected 0 (points)");
    fault([](W w) { w.extension = R"("kernel":"cube","colorSpace":"srgb_rec709_display")"; },
          "KHR_gaussian_splatting.kernel is \"cube\", expected ellipse");
    fault([](W w) { w.extension = R"("kernel":"ellipse","colorSpace":"lin_rec709_display")"; },
          "colorSpace is \"lin_rec709_display\", expected srgb_rec709_display");
    fault([](W w) { w.extension = R"("kernel":"ellipse")"; }, "colorSpace is missing");
    fault(
        [](W w) {
            w.extension = R"("extensions":{"KHR_gaussian_splatting_compression_spz_2":{}})";
        },
        "is compressed by KHR_gaussian_splatting_compression_spz_2, which is not read");
    fault([](W w) { w.further = R"(,"extensionsRequired":["KHR_draco_mesh_compression"])"; },
          "extensionsRequired has \"KHR_draco_mesh_compression\", which is not read");
    fault([](W w) { w.accessors.erase("OPACITY"); },
          "meshes[0].primitives[0].attributes has no KHR_gaussian_splatting:OPACITY");
    fault([](W w) { w.accessors.erase("POSITION"); }, "attributes has no POSITION");
    fault([](W w) { w.accessors["SH_DEGREE_1_COEF_0"] = w.accessors["SCALE"]; },
          "has no KHR_gaussian_splatting:SH_DEGREE_1_COEF_1");
    fault([](W w) { w.accessors["SCALE"] = accessor(5126, false, "VEC4"); },
          ".type is \"VEC4\", expected VEC3");
    fault([](W w) { w.accessors["SCALE"] = accessor(5126, false, "VEC3", 2); },
          ".count is 2, expected 1");
    fault([](W w) { w.accessors["SCALE"] += R"(,"sparse":{})"; },
          "accessors[3].sparse is not supported");
    fault([](W w) { w.accessors["SCALE"] = accessor(5126, false, "VEC3") + R"(,"byteOffset":48)"; },
          "truncated: its data needs bytes 48");
    fault([](W w) { w.view = R"("buffer":0,"byteLength":57)"; },
          "truncated: its data needs bytes 0 to 0 + 57");
    fault([](W w) { w.view += R"(,"byteStride":4)"; }, "byteStride is 4, expected 12 to 252");
    fault([](W w) { w.buffer = R"("uri":"/etc/some","byteLength":56)"; },
          "the URI /etc/some, expected data:");
    fault([](W w) { w.buffer = R"("uri":"http://a/b","byteLength":56)"; },
          "the URI http://a/b, expected");
    fault([](W w) { w.buffer = R"("uri":"a%2","byteLength":56)"; },
          "has a % without two hexadecimal digits");
    fault([](W w) { w.buffer = R"("byteLength":56)"; }, "truncated: the binary chunk");
    fault([](W w) { w.numbers[1] = std::nanf(""); }, "POSITION: component 1 of Gaussian 0 is nan");
    fault([](W w) { w.numbers[6] = 0; },
          "ROTATION of Gaussian 0 is 0, expected a quaternion of length 1");
    fault([](W w) { w.numbers[7] = -1; }, "SCALE of Gaussian 0 is -1, expected at least 0");
    fault([](W w) { w.numbers[10] = 1.5F; }, "OPACITY of Gaussian 0 is 1.5, expected 0 to 1");
    CHECK_FAULT(parse_gltf<float>(as_bytes(Written().text()), "some.gltf"),
                "buffers[0].uri is some%20data.bin, a file of its own, expected data:");
}

TEST_CASE("gltf: damaged GLB files, and memory") {
    const Bytes file = glb_bytes(cloud_of(100, 1));
    const auto read = [](const Bytes& b) { return parse_gltf<float>(b, "some.glb"); };
    const auto changed = [&](std::size_t at, std::uint32_t x) {
        Bytes b = file;
        std::memcpy(b.data() + at, &x, sizeof x);
        return b;
    };
    CHECK_FAULT(read(changed(4, 1)), "some.glb: got GLB version 1, expected 2");
    CHECK_FAULT(read(changed(8, std::uint32_t(file.size() + 1))), "some.glb: truncated: got");
    CHECK_FAULT(read(changed(12, 0xFFFFFFFFU)), "truncated: its JSON chunk");
    CHECK_FAULT(read(changed(16, 7)), "its JSON chunk has the type 7");
    CHECK_FAULT(read(Bytes(file.begin(), file.begin() + 15)), "truncated");
    CHECK_FAULT(parse_gltf<float>(glb_bytes(cloud_of(2000, 1)), "some.glb", 367'999),
                "some.glb: its 2000 Gaussians would take 368000 bytes");
}
