// SPDX-License-Identifier: Apache-2.0
// SPZ files of version 4: a file of Niantic's library with the numbers that the library reads from
// it, round trips, wrong tables and streams by their messages; and stored zstd frames.
#include <rye/io/spz4.hpp>

#include <cstring>

#include <doctest/doctest.h>

#include <rye/io/spz.hpp>

#include "../support/clouds.hpp"
#include "../support/hostile.hpp"

using namespace rye;
using test::cloud_of, test::largest, test::largest_turn, test::opacities;

namespace {

Bytes bytes_of(std::initializer_list<int> numbers) {
    Bytes b;
    for (const int x : numbers) append(b, static_cast<std::uint8_t>(x));
    return b;
}

/// Two Gaussians of degree 1, as version 3.0.0 of the library writes them from axes of a PLY.
Bytes of_the_library() {
    return bytes_of(
        {78,  71,  83,  80,  4,   0,   0,   0,   2,   0,   0,   0,   1,   12,  0,   6,   32,  0,
         0,   0,   0,   0,   0,   0,   0,   0,   0,   0,   0,   0,   0,   0,   27,  0,   0,   0,
         0,   0,   0,   0,   18,  0,   0,   0,   0,   0,   0,   0,   11,  0,   0,   0,   0,   0,
         0,   0,   2,   0,   0,   0,   0,   0,   0,   0,   15,  0,   0,   0,   0,   0,   0,   0,
         6,   0,   0,   0,   0,   0,   0,   0,   15,  0,   0,   0,   0,   0,   0,   0,   6,   0,
         0,   0,   0,   0,   0,   0,   17,  0,   0,   0,   0,   0,   0,   0,   8,   0,   0,   0,
         0,   0,   0,   0,   27,  0,   0,   0,   0,   0,   0,   0,   18,  0,   0,   0,   0,   0,
         0,   0,   40,  181, 47,  253, 32,  18,  145, 0,   0,   66,  105, 254, 193, 5,   1,   71,
         243, 254, 155, 93,  255, 76,  114, 0,   199, 102, 0,   40,  181, 47,  253, 32,  2,   17,
         0,   0,   152, 45,  40,  181, 47,  253, 32,  6,   49,  0,   0,   97,  128, 74,  121, 183,
         184, 40,  181, 47,  253, 32,  6,   49,  0,   0,   77,  100, 204, 29,  145, 71,  40,  181,
         47,  253, 32,  8,   65,  0,   0,   246, 228, 248, 177, 112, 229, 211, 109, 40,  181, 47,
         253, 32,  18,  145, 0,   0,   216, 144, 176, 224, 128, 120, 168, 208, 192, 176, 224, 80,
         104, 176, 40,  200, 72,  64});
}

constexpr std::size_t table_at = 32, frames_at = table_at + 6 * 16;

template <class N>
Bytes changed(Bytes file, std::size_t at, N x) {
    std::memcpy(file.data() + at, &x, sizeof x);
    return file;
}

} // namespace

TEST_CASE("spz4: a file of Niantic's library has the numbers that the library reads") {
    const Bytes file = of_the_library();
    const detail::SpzHeader h = parse_spz4_header(file, "a");
    CHECK(h.version == 4);
    CHECK(h.count == 2);
    CHECK(h.fractional_bits == 12);
    const auto c = parse_spz<double>(file, "a");
    REQUIRE(c.count() == 2);
    REQUIRE(c.degree() == 1);
    Columns<double> mean(3, 2), log_scale(3, 2), rotation(4, 2), opacity(1, 2), constant(3, 2);
    Columns<double> rest(9, 2);
    mean << -25.42139, -10.14966, -16.35962, -7.143555, 16.79517, -6.423584;
    log_scale << -5.1875, -8.1875, -3.75, -0.9375, 2.75, -5.5625;
    rotation << 0.3404076, 0.5092276, -0.3971421, -0.3058133, 0.07887492, -0.726942, -0.8486339,
        -0.3445589;
    opacity << 0.3891516, -1.540445;
    constant << -0.7973855, -0.1699346, 0.01307209, 1.45098, -1.398693, 1.477124;
    rest << -0.6875, -0.375, -0.75, 0.1875, 0.3125, 0.5625, // red
        -0.125, -0.75, 0, -0.375, 0.625, -0.4375,           // green
        -0.375, 0.375, 0.0625, 0.6875, 0.5, -0.5;           // blue
    CHECK(largest(c.mean - mean) <= 1e-5);
    CHECK(largest(c.log_scale - log_scale) <= 1e-6);
    CHECK(largest(c.rotation - rotation) <= 1e-6);
    CHECK(largest(c.logit_opacity - opacity) <= 1e-5);
    CHECK(largest(c.sh_constant - constant) <= 1e-5);
    CHECK(largest(c.sh_rest - rest) <= 1e-6);
}

TEST_CASE("spz4: a round trip stays within the stated bounds, at every degree") {
    for (int degree = 0; degree <= 4; ++degree) {
        const auto c = cloud_of(400, degree);
        const Bytes file = spz4_bytes(c);
        CHECK(std::to_integer<int>(file[15]) == (degree == 0 ? 5 : 6));
        const auto back = parse_spz<double>(file, "a");
        REQUIRE(back.count() == 400);
        REQUIRE(back.degree() == degree);
        CHECK(largest(back.mean - c.mean) <= 1.0 / 8192 + 1e-12);
        CHECK(largest(opacities(back) - opacities(c)) <= 0.5 / 255 + 1e-6);
        CHECK(largest(back.sh_constant - c.sh_constant) <= 0.0131);
        CHECK(largest(back.log_scale - c.log_scale) <= 1.0 / 32 + 1e-12);
        CHECK(largest_turn(back, c) <= 0.28);
        CHECK(largest(back.sh_rest - c.sh_rest) <= 1.0 / 16 + 1e-12);
        // The arrays are those of version 3.
        if (degree > 3) continue;
        const auto before = parse_spz<double>(spz_bytes(c), "a");
        CHECK(before.mean == back.mean);
        CHECK(before.rotation == back.rotation);
        CHECK(before.sh_rest == back.sh_rest);
    }
    CHECK(parse_spz4_header(spz4_bytes(cloud_of(1, 0), stored_zstd, true), "a").antialiased);
    CHECK(parse_spz<float>(spz4_bytes(GaussianCloud<float>(0, 0)), "a").count() == 0);
}

TEST_CASE("spz4: wrong headers, tables and streams are named") {
    const Bytes file = of_the_library();
    const auto read = [](const Bytes& b) { return parse_spz<float>(b, "some.spz"); };
    CHECK_FAULT(read(changed(file, 4, std::uint32_t(5))),
                "some.spz: got SPZ version 5, expected 4");
    CHECK_FAULT(read(changed(file, 12, std::uint8_t(5))), "harmonics of degree 5, expected 0 to 4");
    CHECK_FAULT(read(changed(file, 13, std::uint8_t(24))), "got 24 fractional bits");
    CHECK_FAULT(read(changed(file, 15, std::uint8_t(5))), "got 5 streams, expected 6");
    CHECK_FAULT(read(changed(file, 16, std::uint32_t(31))), "the table begins at byte 31");
    CHECK_FAULT(read(changed(file, 16, std::uint32_t(240))), "truncated: the table");
    CHECK_FAULT(read(changed(file, 8, std::uint32_t(3))),
                "positions of 18 bytes, expected 27 for 3 Gaussians of degree 1");
    CHECK_FAULT(read(changed(file, table_at, std::uint64_t(1) << 60U)), "truncated: positions");
    CHECK_FAULT(read(changed(file, table_at + 5 * 16, std::uint64_t(26))),
                "got 1 bytes after the last stream");
    CHECK_FAULT(read(Bytes(file.begin(), file.begin() + 31)), "truncated: the SPZ header");
    CHECK_FAULT(read(changed(file, frames_at, std::uint8_t(0))),
                "some.spz: positions: zstd: a frame does not begin with");
    CHECK_FAULT(read(changed(file, frames_at + 4, std::uint8_t(0x21))), "without a dictionary");
    CHECK_FAULT(read(changed(file, frames_at + 6, std::uint8_t(145 + 8))), "a block of 19 bytes");
    CHECK_FAULT(read(changed(file, frames_at + 6, std::uint8_t(145 + 4))),
                "positions: zstd: a block is compressed, and no decompressor was given");
    // A count that its frames could not hold, and one that memory could not.
    Bytes many = changed(file, 8, std::uint32_t(100'000'000));
    std::uint64_t each[]{9, 1, 3, 3, 4, 9};
    for (std::size_t k = 0; k < 6; ++k)
        many = changed(many, table_at + 16 * k + 8, each[k] * 100'000'000);
    CHECK_FAULT(read(many), "zstd: a frame of 27 bytes cannot hold the declared 900000000");
    CHECK_FAULT(parse_spz4<float>(file, "some.spz", 200), "its 2 Gaussians would take 242 bytes");
    // Another size than the table's.
    const auto short_by_one = [](ByteSpan, std::size_t size, const std::string&) {
        return Bytes(size - 1);
    };
    CHECK_FAULT(parse_spz4<float>(file, "some.spz", default_memory, short_by_one),
                "some.spz: positions: got 17 bytes, expected 18");
}

TEST_CASE("spz4: records of extensions are skipped, but for axes that are not the format's") {
    const auto with = [](std::initializer_list<std::uint32_t> words) {
        Bytes file = of_the_library();
        file[14] = std::byte(2);
        Bytes records;
        for (const std::uint32_t w : words) append(records, w);
        file.insert(file.begin() + 32, records.begin(), records.end());
        return changed(file, 16, static_cast<std::uint32_t>(32 + records.size()));
    };
    const auto read = [](const Bytes& b) { return parse_spz<float>(b, "some.spz"); };
    CHECK(read(with({0xADBE0002, 12, 1, 2, 3})).count() == 2);
    CHECK(read(with({0xADBE0002, 4, 0, 0xADBE0003, 4, 4})).count() == 2);
    CHECK_FAULT(read(with({0xADBE0003, 4, 6})), "SPZ_ADOBE_coordinate_system is 6, expected 4");
    CHECK_FAULT(read(with({0xADBE0002, 400})), "truncated: an SPZ extension");
}

TEST_CASE("zstd: what is stored is read back, and blocks of one byte") {
    for (const std::size_t size : {std::size_t(0), std::size_t(1), std::size_t(131072),
                                   std::size_t(131073), std::size_t(400000)}) {
        Bytes raw(size);
        for (std::size_t i = 0; i < size; ++i) raw[i] = static_cast<std::byte>(i * i >> 3U);
        CHECK(read_stored_zstd(stored_zstd(raw), size, "a") == raw);
        CHECK_FAULT(read_stored_zstd(stored_zstd(raw), size + 1, "a"),
                    "expected " + std::to_string(size + 1));
    }
    // A window and a checksum; 5 times 7, then 2 bytes as they are.
    const Bytes frame = bytes_of(
        {0x28, 0xB5, 0x2F, 0xFD, 4, 0, 2 + 5 * 8, 0, 0, 7, 1 + 2 * 8, 0, 0, 8, 9, 1, 2, 3, 4});
    CHECK(read_stored_zstd(frame, 7, "a") == bytes_of({7, 7, 7, 7, 7, 8, 9}));
    CHECK_FAULT(read_stored_zstd(frame, 6, "a"), "a block of 2 bytes, expected at most the 1");
    CHECK_FAULT(read_stored_zstd(ByteSpan(frame).first(14), 7, "a"), "truncated: a zstd block");
}
