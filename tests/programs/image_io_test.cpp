// SPDX-License-Identifier: Apache-2.0
// With RYE_DATA set to a folder that holds capture_a, a real JPEG is decoded and damaged too.
#include "image_io.hpp"

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <string>

#include <doctest/doctest.h>

#include <rye/capture/atomic_file.hpp>
#include <rye/capture/bytes.hpp>
#include <rye/capture/inflate.hpp>

#include "../capture/hostile.hpp"

using namespace rye;
using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

Image8 pattern(int width, int height, int channels) {
    Image8 image{width, height, channels, {}};
    for (int i = 0; i < width * height * channels; ++i)
        image.values.push_back(static_cast<std::uint8_t>((i * 37 + i / 11) % 256));
    return image;
}

} // namespace

TEST_CASE("image: a PNG comes back bit by bit, in any number of channels") {
    const TemporaryFolder folder;
    const fs::path path = folder.path / "a b.png";
    for (const int channels : {1, 2, 3, 4}) {
        const Image8 image = pattern(7, 5, channels);
        write_png(path, image);
        const Image8 back = read_image8(path);
        CHECK(back.channels == channels);
        CHECK(back.values == image.values);
        const ImageHeader header = read_image_header(path);
        CHECK(header.width == 7);
        CHECK(header.height == 5);
        CHECK(header.channels == channels);
        CHECK(read_image8(path, 3).values.size() == 7 * 5 * 3);
        CHECK(read_image8(path, 1).channels == 1);
    }
    CHECK(files_in(folder.path) == 1);
}

TEST_CASE("image: floats are the bytes over 255, and every byte survives") {
    Image8 all{16, 16, 1, {}};
    for (int i = 0; i < 256; ++i) all.values.push_back(static_cast<std::uint8_t>(i));
    const Image<float> image = to_float(all);
    CHECK(image.pixels(0, 255) == 1.0f);
    CHECK(image.at(3, 2)[0] == 35.0f / 255.0f);
    CHECK(to_8bit(image).values == all.values);
    Image<float> wild(3, 1, 1);
    wild.pixels << -1.0f, 2.0f, 0.5f;
    CHECK(to_8bit(wild).values == std::vector<std::uint8_t>{0, 255, 128});
    wild.pixels(0, 1) = NAN;
    CHECK_FAULT(to_8bit(wild), "got NaN in value 1");
}

TEST_CASE("image: a failed write leaves the old picture") {
    const TemporaryFolder folder;
    const fs::path path = folder.path / "a.png";
    write_png(path, pattern(4, 4, 1));
    CHECK_FAULT(write_png(path, Image8{0, 0, 1, {}}), "a.png: got an image of 0 x 0 x 1");
    CHECK(read_image8(path).values == pattern(4, 4, 1).values);
    CHECK_FAULT(write_png(folder.path / "no" / "a.png", pattern(4, 4, 1)), "cannot be written");
}

TEST_CASE("image: truncated anywhere or damaged anywhere, a PNG is refused") {
    const TemporaryFolder folder;
    const fs::path path = folder.path / "a.png";
    write_png(path, pattern(9, 9, 3));
    const Bytes whole = read_file(path);
    for (std::size_t n = 0; n < whole.size(); n += 3) {
        write_atomic(path, ByteSpan(whole).first(n));
        CHECK_FAULT(read_image8(path), "a.png: ");
    }
    for (std::size_t i = 0; i < whole.size(); i += 5) {
        Bytes damaged = whole;
        damaged[i] ^= std::byte(0x10);
        write_atomic(path, damaged);
        CHECK_FAULT(read_image8(path), "a.png: ");
    }
    write_atomic(path, {});
    CHECK_FAULT(read_image8(path), "a.png: got 0 bytes, expected a PNG or JPEG");
    CHECK_FAULT(read_image_header(path), "a.png: got 0 bytes, expected a PNG or JPEG");
    write_atomic(path, as_bytes("GIF89a not what it says"));
    CHECK_FAULT(read_image8(path), "neither a PNG nor a JPEG");
    CHECK_FAULT(read_image8(folder.path / "b.png"), "b.png: no such file");
    CHECK_FAULT(read_image_header(folder.path / "b.png"), "b.png: no such file");
}

TEST_CASE("image: a PNG that claims to be huge is refused unread") {
    const TemporaryFolder folder;
    const fs::path path = folder.path / "bomb.png";
    write_png(path, pattern(2, 2, 1));
    Bytes bomb = read_file(path);
    for (const std::size_t at : {16U, 20U}) { // width and height of IHDR, big-endian
        bomb[at] = std::byte(0x7f);
        bomb[at + 1] = bomb[at + 2] = bomb[at + 3] = std::byte(0xff);
    }
    const std::uint32_t crc = crc32(ByteSpan(bomb).subspan(12, 17));
    for (std::size_t i = 0; i < 4; ++i) bomb[29 + i] = static_cast<std::byte>(crc >> (24 - 8 * i));
    write_atomic(path, bomb);
    CHECK_FAULT(read_image8(path), "bomb.png: ");
    CHECK_FAULT(read_image_header(path), "bomb.png: ");
}

TEST_CASE("image: a real JPEG, whole and cut") {
    const char* data = std::getenv("RYE_DATA");
    if (!data) return;
    const fs::path source = fs::path(data) / "capture_a/images/0000/image_08.jpg";
    const Image8 image = read_image8(source, 3);
    CHECK(image.width == 256);
    CHECK(image.values.size() == 3 * 256 * 256);
    const TemporaryFolder folder;
    const fs::path path = folder.path / "cut.jpg";
    const Bytes whole = read_file(source);
    for (const double share : {0.01, 0.3, 0.7, 0.999}) {
        const auto n = static_cast<std::size_t>(share * static_cast<double>(whole.size()));
        write_atomic(path, ByteSpan(whole).first(n));
        CHECK_FAULT(read_image8(path, 3), "cut.jpg: ");
    }
}
