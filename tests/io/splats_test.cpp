// SPDX-License-Identifier: Apache-2.0
// Splat files: .splat, SPZ and GLB against records written down here and by round trips within the
// bounds that the headers state; kinds that are known by sight; wrong files by their messages.
// RYE_DATA may name a folder with splats/test-splat.3-points-from-train.{ply,splat,spz}.
#include <rye/io/splats.hpp>

#include <cstring>

#include <doctest/doctest.h>

#include <rye/io/atomic_file.hpp>
#include <rye/io/json.hpp>
#include <rye/core/random.hpp>

#include "../support/clouds.hpp"
#include "../support/hostile.hpp"
#include "../support/real_data.hpp"

using namespace rye;
using test::cloud_of, test::largest, test::largest_turn, test::opacities;

namespace {

Bytes bytes_of(std::initializer_list<int> numbers) {
    Bytes b;
    for (const int x : numbers) append(b, static_cast<std::uint8_t>(x));
    return b;
}

/// A record of a .splat with chosen numbers in place of its six floats.
Bytes record(std::array<float, 6> numbers) {
    Bytes b;
    for (const float x : numbers) append(b, x);
    append(b, ByteSpan(bytes_of({255, 128, 0, 51, 255, 128, 128, 128})));
    return b;
}

/// The data of an SPZ file: a header of the given numbers, then `bytes` zeros.
Bytes spz_data(std::uint32_t version, std::uint32_t count, std::array<int, 4> small,
               std::size_t bytes) {
    Bytes b;
    append(b, as_bytes("NGSP"));
    append(b, version);
    append(b, count);
    for (const int x : small) append(b, static_cast<std::uint8_t>(x));
    b.resize(b.size() + bytes);
    return b;
}

} // namespace

TEST_CASE("gzip: what is written is read back, with any header, and checked") {
    for (const std::size_t size :
         {std::size_t(0), std::size_t(1), std::size_t(65535), std::size_t(200000)}) {
        Bytes raw(size);
        for (std::size_t i = 0; i < size; ++i) raw[i] = static_cast<std::byte>(i * i >> 3U);
        CHECK(gunzip(gzip_bytes(raw), "a") == raw);
    }
    const Bytes raw = bytes_of({1, 2, 3, 4, 5});
    const Bytes plain = gzip_bytes(raw);
    Bytes full = bytes_of({0x1F, 0x8B, 8, 2 + 4 + 8 + 16, 9, 9, 9, 9, 0, 3});
    append(full, ByteSpan(bytes_of({3, 0, 7, 7, 7, 'n', 0, 'c', 'o', 0, 1, 2})));
    append(full, ByteSpan(plain).subspan(10));
    CHECK(gunzip(full, "a") == raw);
    // As zlib compresses "rye rye rye rye" (fixed codes), with its checksum.
    const Bytes packed =
        bytes_of({0x1F, 0x8B, 8,    0,    0, 0,    0,    0,    2,    255, 0x2B, 0xAA, 0x4C,
                  0x55, 0x28, 0x42, 0x60, 0, 0xE9, 0x54, 0x27, 0x47, 15,  0,    0,    0});
    CHECK(as_text(gunzip(packed, "a")) == "rye rye rye rye");

    const auto changed = [&](std::size_t at, int x) {
        Bytes b = plain;
        b[at] = static_cast<std::byte>(x);
        return b;
    };
    CHECK_FAULT(gunzip(changed(0, 0), "some.spz"), "some.spz: not a gzip file");
    CHECK_FAULT(gunzip(changed(2, 7), "some.spz"), "got method 7, expected 8");
    CHECK_FAULT(gunzip(changed(3, 64), "some.spz"), "got flags 64");
    CHECK_FAULT(gunzip(changed(plain.size() - 8, 1), "some.spz"), "checksum of the data is wrong");
    CHECK_FAULT(gunzip(changed(plain.size() - 4, 9), "some.spz"), "got 5 bytes, expected 9");
    CHECK_FAULT(gunzip(changed(plain.size() - 1, 255), "some.spz"), "cannot hold the declared");
    CHECK_FAULT(gunzip(ByteSpan(plain).first(14), "some.spz"), "truncated: got 14 bytes");
}

TEST_CASE("splat: a record as written down") {
    GaussianCloud<double> c(1, 0);
    c.mean << 1, -2, 3.5;
    c.log_scale << std::log(0.25), std::log(0.5), std::log(4);
    c.sh_constant << 0.5 / detail::sh_factor(0), 0.001 / detail::sh_factor(0), -9;
    c.logit_opacity << logit(0.2);
    c.rotation << 3, 0, 0, 0;
    CHECK(splat_bytes(c) == record({1, -2, 3.5F, 0.25F, 0.5F, 4}));
    const auto back = parse_splat<double>(splat_bytes(c), "a");
    CHECK(back.mean == c.mean);
    CHECK(largest(back.log_scale - c.log_scale) <= 1e-7);
    CHECK(back.rotation(0, 0) > 0.99);
}

TEST_CASE("splat: a round trip stays within the stated bounds") {
    const auto c = cloud_of(500, 2);
    const auto back = parse_splat<double>(splat_bytes(c), "a");
    REQUIRE(back.count() == 500);
    CHECK(back.degree() == 0);
    CHECK(largest(back.mean - c.mean) <= 30.0 / (1 << 24));
    CHECK(largest(back.log_scale - c.log_scale) <= 1e-6);
    CHECK(largest(back.sh_constant - c.sh_constant) * detail::sh_factor(0) <= 0.5 / 255 + 1e-12);
    CHECK(largest(opacities(back) - opacities(c)) <= 0.5 / 255 + 1e-6);
    CHECK(largest_turn(back, c) <= 1);
    CHECK(splat_bytes(parse_splat<double>(splat_bytes(c), "a")).size() ==
          500 * detail::splat_record);
    CHECK(parse_splat<float>({}, "a").count() == 0);
}

TEST_CASE("splat: wrong files and clouds are named") {
    const float nan = std::nanf(""), inf = std::numeric_limits<float>::infinity();
    const auto parsed = [](const Bytes& b) { return parse_splat<float>(b, "some.splat"); };
    Bytes longer = record({1, 2, 3, 1, 1, 1});
    longer.push_back({});
    CHECK_FAULT(parsed(longer), "some.splat: got 33 bytes, expected a multiple of 32");
    CHECK_FAULT(parsed(record({1, nan, 3, 1, 1, 1})), "position y of Gaussian 0 is nan");
    CHECK_FAULT(parsed(record({inf, 2, 3, 1, 1, 1})), "position x of Gaussian 0 is inf");
    CHECK_FAULT(parsed(record({1, 2, 3, 1, 1, -1})), "scale z of Gaussian 0 is -1, expected");
    CHECK_FAULT(parsed(record({1, 2, 3, nan, 1, 1})), "some.splat: scale x of Gaussian 0 is nan");
    auto c = cloud_of(3, 1);
    c.mean(2, 1) = nan;
    CHECK_FAULT(splat_bytes(c), "mean of Gaussian 1 is nan, not finite");
    c = cloud_of(3, 1);
    c.log_scale(0, 0) = 100;
    CHECK_FAULT(splat_bytes(c), "scale of Gaussian 0 is");
}

TEST_CASE("spz: the turn of its axes holds for harmonics and quaternions") {
    const Random random{5, 2};
    std::uint64_t k = 0;
    for (int t = 0; t < 20; ++t) {
        const Vec3<double> d =
            normalized(Vec3<double>(random.normal(k), random.normal(k + 1), random.normal(k + 2)));
        const Vec3<double> turned(d[0], -d[1], -d[2]);
        k += 3;
        const auto a = sh_basis<double, 4>(d), b = sh_basis<double, 4>(turned);
        for (std::size_t j = 0; j < 24; ++j)
            CHECK(b[j + 1] == doctest::Approx(detail::sh_half_turn[j] * a[j + 1]));
        const Quat<double> q =
            quat_normalized(Quat<double>(random.normal(k), d[0], d[1], random.normal(k + 1)));
        const Mat3<double> f = Vec3<double>(1, -1, -1).asDiagonal();
        const Mat3<double> there = quat_matrix(Quat<double>(q[0], q[1], -q[2], -q[3]));
        CHECK(largest(there - f * quat_matrix(q) * f) <= 1e-12);
    }
}

TEST_CASE("spz: a file as written down") {
    GaussianCloud<double> c(1, 1);
    c.mean << 1, -2, 0.25; // stored 1, 2, -0.25
    c.logit_opacity << logit(0.2);
    c.sh_constant << 0, 1, -100;
    c.log_scale << -10, 0, 100;
    c.rotation << 0.5, -0.5, 0.5, -0.5;                 // stored w .5, x -.5, y -.5, z .5
    c.sh_rest << 0.25, 0.25, 0.25, 0, 0, 0, -1, -1, -1; // red, green, blue
    Bytes expected = spz_data(3, 1, {1, 12, 0, 0}, 0);
    append(expected, ByteSpan(bytes_of({0, 0x10, 0, 0, 0x20, 0, 0, 0xFC, 0xFF})));
    append(expected, ByteSpan(bytes_of({51})));
    append(expected, ByteSpan(bytes_of({128, 166, 0})));
    append(expected, ByteSpan(bytes_of({0, 160, 255})));
    // The first of equal components counts as largest: x, which is negative, so y z w have signs
    // relative to it: y +, z -, w -, of 361 = round(511 sqrt(1/2)).
    append(expected, std::uint32_t(361U << 20U | (512U | 361U) << 10U | 512U | 361U));
    append(expected, ByteSpan(bytes_of({96, 128, 255, 96, 128, 255, 160, 128, 0})));
    const Bytes data = gunzip(spz_bytes(c), "a");
    CHECK(data == expected);
    const auto back = parse_spz<double>(spz_bytes(c), "a");
    CHECK(back.mean == c.mean);
    CHECK(back.sh_rest(0, 0) == 0.25);
    CHECK(largest_turn(back, c) <= 0.2);
}

TEST_CASE("spz: a round trip stays within the stated bounds, at every degree") {
    for (int degree = 0; degree <= 3; ++degree) {
        const auto c = cloud_of(400, degree);
        const auto back = parse_spz<double>(spz_bytes(c), "a");
        REQUIRE(back.count() == 400);
        REQUIRE(back.degree() == degree);
        CHECK(largest(back.mean - c.mean) <= 1.0 / 8192 + 1e-12);
        CHECK(largest(opacities(back) - opacities(c)) <= 0.5 / 255 + 1e-6);
        CHECK(largest(back.sh_constant - c.sh_constant) <= 0.0131);
        CHECK(largest(back.log_scale - c.log_scale) <= 1.0 / 32 + 1e-12);
        CHECK(largest_turn(back, c) <= 0.28);
        const Index more = c.sh_rest.rows() / 3;
        for (Index r = 0; r < c.sh_rest.rows(); ++r)
            CHECK(largest(back.sh_rest.row(r) - c.sh_rest.row(r)) <=
                  (r % more < 3 ? 1.0 / 32 : 1.0 / 16) + 1e-12);
        // The antialiased flag and another compressor change no number.
        CHECK(parse_spz_header(gunzip(spz_bytes(c, stored_deflate, true), "a"), "a").antialiased);
    }
    CHECK(parse_spz<float>(spz_bytes(GaussianCloud<float>(0, 0)), "a").count() == 0);
}

TEST_CASE("spz: distant clouds have fewer fractional bits, and their means are kept") {
    auto c = cloud_of(5, 0);
    c.mean(0, 3) = 5000;
    CHECK(parse_spz_header(gunzip(spz_bytes(c), "a"), "a").fractional_bits == 10);
    const auto back = parse_spz<double>(spz_bytes(c), "a");
    CHECK(largest(back.mean - c.mean) <= 1.0 / 2048 + 1e-12);
    c.mean(0, 3) = 1e7;
    CHECK_FAULT(spz_bytes(c), "a mean has a coordinate of 1e+07, expected below 8388607");
}

TEST_CASE("spz: version 1 has positions as float16, which must be finite") {
    Bytes data = spz_data(1, 1, {0, 12, 0, 0}, 0);
    for (const float x : {1.5F, -2.0F, 0.25F}) append(data, Eigen::half(x));
    data.resize(data.size() + 1 + 3 + 3 + 3);
    const auto c = parse_spz<double>(gzip_bytes(data), "a");
    CHECK(c.mean == Vec3<double>(1.5, 2, -0.25));
    CHECK(c.log_scale(0, 0) == -10);
    const Eigen::half infinite(std::numeric_limits<float>::infinity());
    std::memcpy(data.data() + 18, &infinite, 2);
    CHECK_FAULT(parse_spz<double>(gzip_bytes(data), "some.spz"),
                "some.spz: position y of Gaussian 0 is inf, expected a finite number");
}

TEST_CASE("spz: quaternions of version 2") {
    Bytes data = spz_data(2, 1, {0, 12, 0, 0}, 9 + 1 + 3 + 3);
    append(data, ByteSpan(bytes_of({128, 204, 51}))); // x 0.004, y 0.6, z -0.6
    const auto c = parse_spz<double>(gzip_bytes(data), "a");
    CHECK(c.rotation(1, 0) == doctest::Approx(0.00392).epsilon(0.01));
    CHECK(c.rotation(2, 0) == doctest::Approx(-0.6));
    CHECK(c.rotation(3, 0) == doctest::Approx(0.6));
    CHECK(c.rotation.col(0).norm() == doctest::Approx(1));
}

TEST_CASE("spz: wrong files and clouds are named") {
    const auto read = [](const Bytes& data) {
        return parse_spz<float>(gzip_bytes(data), "some.spz");
    };
    constexpr std::size_t record_bytes = 20;
    CHECK(read(spz_data(3, 2, {0, 12, 0, 0}, 2 * record_bytes)).count() == 2);
    CHECK(read(spz_data(3, 1, {0, 12, 2, 0}, record_bytes + 5)).count() == 1); // an extension
    CHECK_FAULT(parse_spz<float>(spz_data(3, 0, {0, 12, 0, 0}, 16), "some.spz"),
                "some.spz: got SPZ version 3, expected 4, or 1 to 3 in gzip");
    CHECK_FAULT(parse_spz<float>(Bytes(20), "some.spz"), "not a gzip file");
    CHECK_FAULT(read(bytes_of({1, 2, 3})), "some.spz: truncated: the SPZ header");
    CHECK_FAULT(read(Bytes(16)), "do not begin with \"NGSP\"");
    CHECK_FAULT(read(spz_data(0, 1, {0, 12, 0, 0}, 99)), "got SPZ version 0, expected 1 to 3");
    CHECK_FAULT(read(spz_data(4, 1, {0, 12, 0, 0}, 99)), "got SPZ version 4, expected 1 to 3");
    CHECK_FAULT(read(spz_data(3, 1, {5, 12, 0, 0}, 99)), "harmonics of degree 5, expected 0 to 4");
    CHECK_FAULT(read(spz_data(3, 1, {0, 24, 0, 0}, record_bytes)), "got 24 fractional bits");
    CHECK_FAULT(read(spz_data(3, 0xFFFFFFFFU, {3, 12, 0, 0}, 64)), "expected 279172874191");
    CHECK_FAULT(read(spz_data(3, 1, {0, 12, 0, 0}, 21)), "got 37 bytes of data, expected 36");
    CHECK_FAULT(spz_bytes(cloud_of(1, 4)), "degree 4, expected at most 3");
}

TEST_CASE("glb: its chunks, and each array where the text says, as glTF's axes want it") {
    const auto c = cloud_of(7, 3);
    const Bytes file = glb_bytes(c);
    const auto word = [&](std::size_t at) { return read_at<std::uint32_t>(file, at, "a", "b"); };
    CHECK(as_text(ByteSpan(file).first(4)) == "glTF");
    CHECK(word(4) == 2);
    REQUIRE(word(8) == file.size());
    const std::size_t json_size = word(12), data_at = 20 + json_size + 8;
    CHECK(json_size % 4 == 0);
    CHECK(as_text(ByteSpan(file).subspan(16, 4)) == "JSON");
    CHECK(word(20 + json_size) == file.size() - data_at);
    CHECK(word(24 + json_size) == 0x004E4942);
    const JsonValue json =
        parse_json(std::string_view(as_text(ByteSpan(file).subspan(20, json_size))), "a");
    const auto number = [](const JsonValue& v) {
        if (const auto* whole = v.get<std::int64_t>()) return static_cast<double>(*whole);
        return *v.get<double>();
    };
    const JsonValue& primitive =
        json.find("meshes")->get<JsonArray>()->at(0).find("primitives")->get<JsonArray>()->at(0);
    CHECK(number(*primitive.find("mode")) == 0);
    CHECK(*primitive.find("extensions")
               ->find("KHR_gaussian_splatting")
               ->find("kernel")
               ->get<std::string>() == "ellipse");
    const JsonArray& accessors = *json.find("accessors")->get<JsonArray>();
    const JsonArray& views = *json.find("bufferViews")->get<JsonArray>();
    const auto array = [&](const std::string& name, Index rows) {
        const JsonValue* index = primitive.find("attributes")->find(name);
        INFO(name);
        REQUIRE(index != nullptr);
        const JsonValue& accessor = accessors.at(static_cast<std::size_t>(number(*index)));
        CHECK(number(*accessor.find("count")) == 7);
        CHECK(*accessor.find("type")->get<std::string>() == (rows == 1   ? "SCALAR"
                                                             : rows == 3 ? "VEC3"
                                                                         : "VEC4"));
        const JsonValue& view =
            views.at(static_cast<std::size_t>(number(*accessor.find("bufferView"))));
        const auto offset = static_cast<std::size_t>(number(*view.find("byteOffset")));
        Columns<float> a(rows, 7);
        REQUIRE(number(*view.find("byteLength")) == 4.0 * double(a.size()));
        std::memcpy(a.data(), file.data() + data_at + offset, 4 * std::size_t(a.size()));
        if (const JsonValue* least = accessor.find("min"))
            for (Index k = 0; k < rows; ++k)
                CHECK(static_cast<float>(number(least->get<JsonArray>()->at(std::size_t(k)))) ==
                      a.row(k).minCoeff());
        return Columns<double>(a.cast<double>());
    };
    const Vec3<double> flip(1, -1, -1);
    CHECK(largest(array("POSITION", 3) - flip.asDiagonal() * c.mean) <= 1e-5);
    const std::string stem = "KHR_gaussian_splatting:";
    const Columns<double> scale = c.log_scale.array().exp();
    CHECK(largest(array(stem + "SCALE", 3) - scale) <= 1e-5);
    CHECK(largest(array(stem + "OPACITY", 1) - opacities(c)) <= 1e-6);
    // For programs that draw points: linear light, and the opacity.
    const JsonValue& colours = accessors.at(
        static_cast<std::size_t>(number(*primitive.find("attributes")->find("COLOR_0"))));
    CHECK(number(*colours.find("componentType")) == 5123);
    CHECK(*colours.find("normalized")->get<bool>());
    CHECK(*colours.find("type")->get<std::string>() == "VEC4");
    const JsonValue& seen = views.at(static_cast<std::size_t>(number(*colours.find("bufferView"))));
    Columns<std::uint16_t> shares(4, 7);
    std::memcpy(shares.data(),
                file.data() + data_at + static_cast<std::size_t>(number(*seen.find("byteOffset"))),
                56);
    for (Index i = 0; i < 7; ++i) {
        for (Index k = 0; k < 3; ++k)
            CHECK(
                shares(k, i) / 65535.0 ==
                doctest::Approx(linear_from_srgb(0.5 + detail::sh_factor(0) * c.sh_constant(k, i)))
                    .epsilon(1e-3));
        CHECK(shares(3, i) / 65535.0 == doctest::Approx(opacities(c)(0, i)).epsilon(1e-3));
    }
    const Columns<double> q = array(stem + "ROTATION", 4);
    for (Index i = 0; i < 7; ++i) {
        const Quat<double> own = quat_normalized<double>(c.rotation.col(i));
        const Mat3<double> f = flip.asDiagonal();
        const Mat3<double> there = quat_matrix(Quat<double>(q(3, i), q(0, i), q(1, i), q(2, i)));
        CHECK(largest(there - f * quat_matrix(own) * f) <= 1e-5);
    }
    CHECK(largest(array(stem + "SH_DEGREE_0_COEF_0", 3) - c.sh_constant) <= 1e-6);
    for (const auto& [name, k] : {std::pair<const char*, Index>{"SH_DEGREE_1_COEF_0", 0},
                                  {"SH_DEGREE_1_COEF_2", 2},
                                  {"SH_DEGREE_2_COEF_4", 7},
                                  {"SH_DEGREE_3_COEF_0", 8},
                                  {"SH_DEGREE_3_COEF_6", 14}}) {
        const Columns<double> a = array(stem + name, 3);
        const double sign = detail::sh_half_turn[static_cast<std::size_t>(k)];
        for (Index channel = 0; channel < 3; ++channel)
            CHECK(largest(a.row(channel) - sign * c.sh_rest.row(15 * channel + k)) <= 1e-6);
    }
}

TEST_CASE("glb: wrong clouds are named") {
    CHECK_FAULT(glb_bytes(GaussianCloud<float>(0, 0)), "got no Gaussians");
    CHECK_FAULT(glb_bytes(cloud_of(2, 4)), "degree 4, expected at most 3");
    auto c = cloud_of(2, 0);
    c.sh_constant(1, 1) = std::nan("");
    CHECK_FAULT(glb_bytes(c), "sh_constant of Gaussian 1 is nan");
    c = cloud_of(2, 0);
    c.mean(0, 0) = 1e300;
    CHECK_FAULT(glb_bytes(c), "mean has a number beyond the range of float");
    c = cloud_of(2, 0);
    c.logit_opacity.conservativeResize(1, 1);
    CHECK_FAULT(glb_bytes(c), "logit_opacity has 1 columns, expected 2");
}

TEST_CASE("splats: a rotation of zeros is the identity in every file (C1)") {
    auto c = cloud_of(3, 1), turned = c;
    c.rotation.col(2).setZero();
    turned.rotation.col(2) = Quat<double>(1, 0, 0, 0);
    CHECK(splat_bytes(c) == splat_bytes(turned));
    CHECK(spz_bytes(c) == spz_bytes(turned));
    CHECK(glb_bytes(c) == glb_bytes(turned));
    std::stringstream ply;
    write_ply(ply, c);
    const auto back = read_ply<double>(ply, "a.ply");
    CHECK(back.rotation.col(2).isZero(0));
    CHECK(quat_normalized<double>(back.rotation.col(2)) == Quat<double>(1, 0, 0, 0));
}

TEST_CASE("splats: files are read by their kind, whatever their name, and written by their name") {
    const TemporaryFolder folder;
    const auto c = cloud_of(20, 0);
    const auto put = [&](const char* name, const Bytes& bytes) {
        write_atomic(folder.path / name, bytes, Durability::atomic_only);
        return folder.path / name;
    };
    const auto bytes = [&](const char* name) {
        return splat_file_bytes(c, {.kind = written_splat_kind(name, "export")});
    };
    CHECK(read_splats<double>(put("a.ply", bytes("a.PLY"))).count() == 20);
    CHECK(read_splats<double>(put("a.splat", bytes("b.splat"))).count() == 20);
    CHECK(read_splats<double>(put("a.spz", bytes("c.spz"))).count() == 20);
    CHECK(read_splats<double>(put("named.splat", bytes("a.spz"))).count() == 20);
    CHECK(read_splats<double>(put("no_extension", bytes("a.ply"))).count() == 20);
    CHECK(read_splats<double>(put("a.glb", bytes("d.glb"))).count() == 20);
    CHECK(splat_kind("a", bytes("a.glb")) == SplatKind::glb);
    CHECK(splat_kind("a", bytes("a.usda")) == SplatKind::usda);
    const auto version_4 = put("4.spz", splat_file_bytes(c, {.kind = SplatKind::spz4}));
    CHECK(read_splats<double>(version_4, default_memory, read_stored_zstd).count() == 20);
    for (const char* name : {"a.compressed.ply", "a.txt", "a", "a.ksplat", "a.sog"})
        CHECK_FAULT(written_splat_kind(name, "rye export"),
                    "rye export: got the name " + std::string(name) + ", expected one that ends");
}

TEST_CASE("splats: what is known but not read is named, with the command that converts it") {
    const TemporaryFolder folder;
    const auto told = [&](const char* name, std::string_view text, const std::string& words) {
        const std::filesystem::path path = folder.path / name;
        write_atomic(path, as_bytes(text), Durability::atomic_only);
        INFO(name);
        CHECK_FAULT(read_splats<float>(path), words);
        CHECK_FAULT(read_splats<float>(path), path.string());
    };
    const std::string command =
        ", which is not read; convert it with: npx "
        "@playcanvas/splat-transform ";
    told("a.ply",
         "ply\nformat binary_little_endian 1.0\nelement chunk 1\nproperty float min_x\n"
         "element vertex 1\nproperty uint packed_position\nend_header\n",
         "a compressed PLY (PlayCanvas)" + command);
    told("a.spz", std::string_view("NGSP\x04\0\0\0", 8),
         "SPZ version 4, but this program was built without zstd; convert it with: npx "
         "@playcanvas/splat-transform@2.7.1 ");
    told("a.sog", "PK\x03\x04", "SOG (PlayCanvas)" + command);
    told("meta.json", "{}", "SOG (PlayCanvas)" + command);
    told("a.ksplat", std::string_view("\0\1\0\0", 4), "KSPLAT (GaussianSplats3D)" + command);
    told("a.lcc", "{}", "LCC (XGRIDS)" + command);
    told("a.glb", "glTF", "truncated: the GLB header");
    told("a.gltf", "{}", "asset.version is missing");
    told("a.usda", "#usda 1.0", "OpenUSD, which is not read; give the PLY");
    told("a.txt", "hello", "no splat file that is known: expected a PLY, .splat, SPZ or glTF");
    told("b.spz", "", "not a gzip file");
    told("b.splat", "x", "got 1 bytes, expected a multiple of 32");
    CHECK_FAULT(read_splats<float>(folder.path), "a folder, expected a file");
    CHECK_FAULT(read_splats<float>(folder.path / "none.ply"), "none.ply: no such file");
}

TEST_CASE("splats: three files that other programs wrote hold the same three Gaussians") {
    const std::string stem = "splats/test-splat.3-points-from-train.";
    const auto ply = test::real_data((stem + "ply").c_str());
    const auto splat = test::real_data((stem + "splat").c_str());
    const auto spz = test::real_data((stem + "spz").c_str());
    if (!ply || !splat || !spz) return;
    const auto a = read_splats<double>(*ply), b = read_splats<double>(*splat);
    const auto c = read_splats<double>(*spz);
    REQUIRE(a.count() == 3);
    REQUIRE(b.count() == 3);
    REQUIRE(c.count() == 3);
    CHECK(largest(b.mean - a.mean) <= 1e-6);
    CHECK(largest(b.log_scale - a.log_scale) <= 1e-5);
    CHECK(largest_turn(a, b) <= 1.5); // its writer rounds toward 0
    CHECK(largest(opacities(b) - opacities(a)) <= 1.0 / 255);
    CHECK(c.degree() == 3);
    CHECK(largest(c.mean - a.mean) <= 1.0 / 8192 + 1e-6);
    CHECK(largest(opacities(c) - opacities(a)) <= 0.5 / 255 + 1e-6);
    CHECK(largest(c.sh_constant - a.sh_constant) <= 0.0131);
    CHECK(largest(c.log_scale - a.log_scale) <= 1.0 / 32 + 1e-6);
    REQUIRE(a.degree() == 3);
    CHECK(largest(c.sh_rest - a.sh_rest) <= 1.0 / 16 + 1.0 / 256 + 1e-6); // its writer rounds twice
    CHECK(largest_turn(a, c) <= 0.2);
}
