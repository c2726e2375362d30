// SPDX-License-Identifier: Apache-2.0
// Videos: their bytes by the specifications of APNG and Y4M, numbered pictures, --out and --fps.
#include "data/moving_picture.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <fstream>
#include <string>
#include <vector>

#include <rye/io/inflate.hpp>

#include "../support/file_bytes.hpp"
#include "../support/hostile.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

/// Odd sides, and other colours in each.
Image8 colours(int number) {
    Image8 image{5, 3, 3, {}};
    for (int i = 0; i < 45; ++i)
        image.values.push_back(static_cast<std::uint8_t>((37 * i + 101 * number) % 256));
    return image;
}

void write(const fs::path& out, OutFormat format, FrameRate rate = {}) {
    const auto video = moving_picture(out, format, rate, 3);
    for (int k = 0; k < 3; ++k) video->add(colours(k));
    video->finish();
}

std::uint32_t u32(const std::string& bytes, std::size_t at) {
    std::uint32_t x = 0;
    for (std::size_t i = 0; i < 4; ++i) x = x << 8U | static_cast<std::uint8_t>(bytes[at + i]);
    return x;
}

struct Chunk {
    std::string type, data;
};

/// The chunks of a PNG, whose checksums are right.
std::vector<Chunk> chunks_of(const std::string& png) {
    REQUIRE(png.substr(0, 8) == "\x89PNG\r\n\x1a\n");
    std::vector<Chunk> all;
    for (std::size_t at = 8; at < png.size();) {
        const std::size_t length = u32(png, at);
        all.push_back({png.substr(at + 4, 4), png.substr(at + 8, length)});
        CHECK(crc32(as_bytes(png.substr(at + 4, 4 + length))) == u32(png, at + 8 + length));
        at += 12 + length;
    }
    return all;
}

/// A PNG of one picture, of an APNG's IHDR and these compressed pixels.
std::string still(const Chunk& header, const std::string& pixels) {
    std::string png = "\x89PNG\r\n\x1a\n";
    for (const Chunk& c : {header, Chunk{"IDAT", pixels}, Chunk{"IEND", ""}}) {
        const auto number = [&](std::uint32_t x) {
            for (int shift = 24; shift >= 0; shift -= 8) png += static_cast<char>(x >> shift);
        };
        number(static_cast<std::uint32_t>(c.data.size()));
        png += c.type + c.data;
        number(crc32(as_bytes(c.type + c.data)));
    }
    return png;
}

} // namespace

TEST_CASE("an animated PNG has the chunks of its specification, and its pictures every bit") {
    const TemporaryFolder folder;
    const fs::path out = folder.path / "a.apng";
    write(out, OutFormat::apng, {30000, 1001});
    const std::vector<Chunk> all = chunks_of(bytes_of(out));
    std::string order;
    for (const Chunk& c : all) order += c.type + " ";
    CHECK(order == "IHDR acTL fcTL IDAT fcTL fdAT fcTL fdAT IEND ");
    CHECK(u32(all[1].data, 0) == 3);
    CHECK(u32(all[1].data, 4) == 0);
    std::uint32_t sequence = 0;
    int picture = 0;
    for (const Chunk& c : all) {
        if (c.type == "fcTL") {
            CHECK(u32(c.data, 0) == sequence++);
            CHECK(u32(c.data, 4) == 5);
            CHECK(u32(c.data, 8) == 3);
            CHECK(u32(c.data, 20) == (1001U << 16U | 30000U)); // seconds of a picture
        }
        if (c.type != "fdAT" && c.type != "IDAT") continue;
        if (c.type == "fdAT") CHECK(u32(c.data, 0) == sequence++);
        const std::string png = still(all.front(), c.type == "fdAT" ? c.data.substr(4) : c.data);
        CHECK(decode_image(as_bytes(png), "picture").values == colours(picture++).values);
    }
    CHECK(picture == 3);
    // A program that knows PNG alone shows the first picture.
    CHECK(read_image8(out).values == colours(0).values);
}

TEST_CASE("Y4M has a header, a mark a frame, and the colours of Rec. 601") {
    const TemporaryFolder folder;
    const fs::path out = folder.path / "a.y4m";
    write(out, OutFormat::y4m);
    std::string bytes = bytes_of(out);
    const std::string header = "YUV4MPEG2 W5 H3 F25:1 Ip A1:1 C444 XCOLORRANGE=LIMITED\n";
    REQUIRE(bytes.size() == header.size() + 3 * (6 + 45));
    CHECK(bytes.substr(0, header.size()) == header);
    for (std::size_t k = 0; k < 3; ++k) {
        const std::string frame = bytes.substr(header.size() + k * 51, 51);
        CHECK(frame.substr(0, 6) == "FRAME\n");
        const Image8 picture = colours(static_cast<int>(k));
        for (std::size_t i = 0; i < 15; ++i) {
            const double r = picture.values[3 * i] / 255., g = picture.values[3 * i + 1] / 255.,
                         b = picture.values[3 * i + 2] / 255.;
            const double y = 0.299 * r + 0.587 * g + 0.114 * b;
            const double expected[] = {16 + 219 * y, 128 + 224 * (b - y) / 1.772,
                                       128 + 224 * (r - y) / 1.402};
            for (std::size_t c = 0; c < 3; ++c)
                CHECK(std::abs(static_cast<std::uint8_t>(frame[6 + 15 * c + i]) - expected[c]) <
                      0.51);
        }
    }
}

TEST_CASE("a video that is not finished leaves no file, and the old one as it was") {
    const TemporaryFolder folder;
    for (const auto& [name, format] :
         {std::pair("a.apng", OutFormat::apng), std::pair("a.y4m", OutFormat::y4m)}) {
        const fs::path out = folder.path / name;
        { moving_picture(out, format, {}, 3)->add(colours(0)); }
        CHECK_FALSE(fs::exists(out));
        std::ofstream(out) << "old";
        { moving_picture(out, format, {}, 3)->add(colours(0)); }
        CHECK(bytes_of(out) == "old");
    }
    CHECK(files_in(folder.path) == 2);
}

TEST_CASE("pictures of another size are refused") {
    const TemporaryFolder folder;
    const auto video = moving_picture(folder.path / "a.y4m", OutFormat::y4m, {}, 2);
    video->add(colours(0));
    CHECK_FAULT(video->add(Image8{1, 1, 3, {0, 0, 0}}), "expected 5 x 3 x 3");
}

TEST_CASE("numbered pictures sort by name, and a folder that has some is refused") {
    const TemporaryFolder folder;
    const fs::path out = folder.path / "pictures";
    write(out, OutFormat::picture_folder);
    for (int k = 0; k < 3; ++k)
        CHECK(read_image8(out / ("frame_000" + std::to_string(k) + ".png")).values ==
              colours(k).values);
    CHECK_FAULT(write(out, OutFormat::picture_folder), "holds pictures already");
    CHECK(numbered_picture(7, 10001) == "frame_00007.png");
    CHECK(numbered_picture(9999, 10000) == "frame_9999.png");
}

TEST_CASE("the name of --out decides") {
    const std::vector<OutFormat> all{OutFormat::png, OutFormat::jpeg, OutFormat::apng,
                                     OutFormat::y4m_stream, OutFormat::picture_folder};
    const auto of = [&](const char* name) { return out_format(name, all, "--out"); };
    CHECK(of("a.png") == OutFormat::png);
    CHECK(of("a.PNG") == OutFormat::png);
    CHECK(of("b/a.jpeg") == OutFormat::jpeg);
    CHECK(of("-") == OutFormat::y4m_stream);
    CHECK(of("b.c/pictures") == OutFormat::picture_folder);
    CHECK(of("pictures/") == OutFormat::picture_folder);
    CHECK_FAULT(of("a.txt"),
                "--out: got 'a.txt', expected .png, .jpg, .apng, - (Y4M on standard "
                "output) or no extension (a folder of pictures)");
    CHECK_FAULT(out_format("-", {OutFormat::png, OutFormat::picture_folder}, "--out"), "got '-'");
    CHECK_FAULT(out_format("a", {OutFormat::png}, "--out"), "expected .png");
}

TEST_CASE("pictures a second") {
    CHECK(parsed_rate("25", "--fps").pictures == 25);
    CHECK(parsed_rate("30000/1001", "--fps").seconds == 1001);
    for (const char* wrong :
         {"", "0", "-25", "25.5", "25/", "25/0", "1/2", "70000", "1001", "25x", "1001/1"})
        CHECK_FAULT(parsed_rate(wrong, "--fps"), std::string("--fps: got '") + wrong + "'");
}
