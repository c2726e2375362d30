// SPDX-License-Identifier: Apache-2.0
// Bases beside a splat file: what is written is read back; bases that no viewer could apply, and
// wrong files, by their messages.
#include <rye/io/splat_bases.hpp>

#include <cmath>
#include <functional>
#include <limits>

#include <doctest/doctest.h>

#include "../support/hostile.hpp"

using namespace rye;

namespace {

/// Three bases of five Gaussians, the last two of which are eyes.
SplatBases small_bases() {
    SplatBases b;
    b.gaussians = 5;
    b.bases = {{"jawOpen", 0, 0.75}, {"gaze_left_yaw", 2, 30}, {"gaze_left_yaw", 2, -25.5}};
    b.begin = {0, 2, 2, 3};
    b.index = {0, 2, 4};
    b.change.resize(basis_numbers, 3);
    for (Index i = 0; i < b.change.size(); ++i)
        b.change.data()[i] = Eigen::half(0.125F * static_cast<float>(i) - 1);
    b.eyes[0] = {3, 1, Vec3<double>(0.3, -0.25, 1), {1, 2}, {0, 5}};
    b.eyes[1] = {4, 1, Vec3<double>(-0.3, 1.0 / 3, 1e-7), {-1, -2}, {0, -5}};
    b.head = Vec4<double>(0, 1, 0, 0);
    return b;
}

/// small_bases with a change.
SplatBases with(const std::function<void(SplatBases&)>& change) {
    SplatBases b = small_bases();
    change(b);
    return b;
}

} // namespace

TEST_CASE("bases: what is written is read back") {
    const TemporaryFolder folder;
    const std::filesystem::path path = folder.path / "head.safetensors";
    const SplatBases b = small_bases();
    write_bases(path, b);
    const SplatBases read = read_bases(path);
    CHECK(read.gaussians == b.gaussians);
    REQUIRE(read.bases.size() == 3);
    for (std::size_t k = 0; k < 3; ++k) {
        CHECK(read.bases[k].driver == b.bases[k].driver);
        CHECK(read.bases[k].rest == b.bases[k].rest);
        CHECK(read.bases[k].at == b.bases[k].at);
    }
    CHECK(read.begin == b.begin);
    CHECK(read.index == b.index);
    CHECK(read.change.cast<float>() == b.change.cast<float>());
    for (std::size_t e = 0; e < 2; ++e) {
        CHECK(read.eyes[e].first == b.eyes[e].first);
        CHECK(read.eyes[e].count == b.eyes[e].count);
        CHECK(read.eyes[e].centre == b.eyes[e].centre);
        CHECK(read.eyes[e].gaze == b.eyes[e].gaze);
        CHECK(read.eyes[e].kappa == b.eyes[e].kappa);
    }
    CHECK(read.head == b.head);

    SplatBases none;
    none.change.resize(basis_numbers, 0);
    write_bases(path, none);
    CHECK(read_bases(path).bases.empty());
}

TEST_CASE("bases: what no viewer could apply is not written, and leaves the file") {
    const TemporaryFolder folder;
    const std::filesystem::path path = folder.path / "head.safetensors";
    write_bases(path, small_bases());
    const Bytes before = read_file(path);
    const auto written = [&](const std::function<void(SplatBases&)>& change) {
        write_bases(path, with(change));
        return 0;
    };
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const auto half = static_cast<Eigen::half>(std::numeric_limits<float>::infinity());
    CHECK_FAULT(written([](SplatBases& b) { b.bases[0].driver = ""; }),
                "head.safetensors: not written: 'bases': basis 0: its driver has no name");
    CHECK_FAULT(written([](SplatBases& b) { b.bases[1].driver = "\xFF"; }), "basis 1: ");
    CHECK_FAULT(written([](SplatBases& b) { b.bases[2].at = 31; }),
                "basis 2: a second one of 'gaze_left_yaw' toward this side");
    CHECK_FAULT(written([&](SplatBases& b) { b.bases[0].rest = nan; }),
                "basis 0: 'rest': got nan, expected a finite number");
    CHECK_FAULT(written([](SplatBases& b) { b.bases[0].at = 0; }),
                "basis 0: 'at' is 'rest', 0, expected another number");
    CHECK_FAULT(written([&](SplatBases& b) { b.change(4, 1) = half; }),
                "'change': number 4 of entry 1 is inf, expected a finite number");
    CHECK_FAULT(written([](SplatBases& b) { b.change.resize(12, 3); }),
                "'change': got 3 x 12, expected 3 x 13");
    CHECK_FAULT(written([](SplatBases& b) { b.index[2] = 5; }),
                "'index': entry 2 of basis 2 is 5, expected ascending numbers below 5");
    CHECK_FAULT(written([](SplatBases& b) { b.index[1] = 0; }), "entry 1 of basis 0 is 0");
    CHECK_FAULT(written([](SplatBases& b) { b.begin[1] = 4; }), "'begin': number 2 is 2");
    CHECK_FAULT(written([](SplatBases& b) { b.begin.back() = 2; }),
                "'begin': got 0 to 2, expected 0 to 3");
    CHECK_FAULT(written([](SplatBases& b) { b.eyes[1].count = 2; }),
                "'eyes': eye 1: got Gaussians from 4 on, 2, of 5");
    CHECK_FAULT(written([&](SplatBases& b) { b.eyes[0].centre[1] = nan; }),
                "'eyes': eye 0: got nan");
    CHECK_FAULT(written([](SplatBases& b) { b.head[0] = 1; }), "'head': got a quaternion");
    CHECK(read_file(path) == before);
}

TEST_CASE("bases: wrong files are told by their messages") {
    const TemporaryFolder folder;
    const std::filesystem::path path = folder.path / "b.safetensors";
    const SplatBases b = small_bases();
    const TensorMetadata words{{"format", detail::bases_format},
                               {"version", detail::bases_version},
                               {"gaussians", "5"},
                               {"head", "[1,0,0,0]"},
                               {"bases", "[]"},
                               {"eyes", "[]"}};
    const auto read = [&](const std::string& key, const std::string& word) {
        TensorMetadata metadata = words;
        metadata[key] = word;
        write_safetensors(path, {tensor_entry<std::uint32_t>("index", {3}, b.index)}, metadata);
        return read_bases(path);
    };
    CHECK_FAULT(read("format", "rye-avatar"),
                "b.safetensors: metadata 'format': got 'rye-avatar', expected 'rye-bases'");
    CHECK_FAULT(read("version", "2"), "metadata 'version': got '2', expected '1'");
    CHECK_FAULT(read("gaussians", "-1"), "metadata 'gaussians': expected a count");
    CHECK_FAULT(read("head", "[1,0,0]"), "metadata 'head': expected a list of 4");
    CHECK_FAULT(read("head", "[1,0,0,\"x\"]"), "metadata 'head': a number is missing");
    CHECK_FAULT(read("bases", "[{\"rest\":0}]"), "metadata 'bases': a 'driver' is missing");
    CHECK_FAULT(read("bases", "[{\"driver\":\"a\",\"rest\":0}]"), "a number is missing");
    CHECK_FAULT(read("eyes", "[{},{},{}]"), "metadata 'eyes': expected a list of 2");
    CHECK_FAULT(read("eyes", "[{},{}]"), "metadata 'eyes': expected a count");
    write_bases(path, b);
    Bytes cut = read_file(path);
    cut.pop_back();
    CHECK_FAULT(parse_bases(cut, "cut"), "cut: ");
}
