// SPDX-License-Identifier: Apache-2.0
// With RYE_DATA set to a folder that holds capture_a, a real JPEG is decoded and damaged too.
#include "../support/real_data.hpp"
#include "data/picture.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <initializer_list>
#include <string>

#include <sys/resource.h>
#include <sys/stat.h>

#include <doctest/doctest.h>

#include <rye/io/atomic_file.hpp>
#include <rye/io/bytes.hpp>
#include <rye/io/inflate.hpp>

#include "../support/hostile.hpp"

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

Bytes of(std::initializer_list<int> values) {
    Bytes out;
    for (const int v : values) out.push_back(static_cast<std::byte>(v));
    return out;
}

Bytes read_jpeg_bytes(int channels) {
    const TemporaryFolder folder;
    write_jpeg(folder.path / "a.jpg", pattern(16, 16, channels), 80);
    return read_file(folder.path / "a.jpg");
}

void append_big_endian(Bytes& to, std::uint32_t value) {
    for (int i = 0; i < 4; ++i) to.push_back(static_cast<std::byte>(value >> (24 - 8 * i)));
}

Bytes chunk(std::string_view name, ByteSpan body) {
    Bytes named(as_bytes(name).begin(), as_bytes(name).end()), out;
    append(named, body);
    append_big_endian(out, static_cast<std::uint32_t>(body.size()));
    append(out, named);
    append_big_endian(out, crc32(named));
    return out;
}

/// A PNG of any kind: rows of filter bytes and samples, stored in one block of deflate.
Bytes png_of(std::uint32_t width, std::uint32_t height, int bits, int type, ByteSpan rows,
             ByteSpan before_data = {}) {
    Bytes png(as_bytes("\x89PNG\r\n\x1a\n").begin(), as_bytes("\x89PNG\r\n\x1a\n").end());
    Bytes header, data = of({0x78, 0x01, 0x01});
    append_big_endian(header, width);
    append_big_endian(header, height);
    append(header, of({bits, type, 0, 0, 0}));
    const auto n = static_cast<std::uint16_t>(rows.size());
    append(data, n);
    append(data, static_cast<std::uint16_t>(~n));
    append(data, rows);
    std::uint32_t a = 1, b = 0; // zlib's Adler-32
    for (const std::byte x : rows) {
        a = (a + static_cast<std::uint32_t>(x)) % 65521U;
        b = (b + a) % 65521U;
    }
    append_big_endian(data, b << 16U | a);
    append(png, chunk("IHDR", header));
    append(png, before_data);
    append(png, chunk("IDAT", data));
    append(png, chunk("IEND", {}));
    return png;
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

TEST_CASE("image: a JPEG comes back nearly, grey as grey and colour as colour") {
    const TemporaryFolder folder;
    const fs::path path = folder.path / "a.jpg";
    for (const int channels : {1, 3}) {
        Image8 image{40, 24, channels, {}};
        for (int y = 0; y < 24; ++y)
            for (int x = 0; x < 40; ++x)
                for (int c = 0; c < channels; ++c)
                    image.values.push_back(static_cast<std::uint8_t>(40 + 3 * x + y * c));
        write_jpeg(path, image, 95);
        const Image8 back = read_image8(path);
        REQUIRE(back.channels == channels);
        REQUIRE(back.values.size() == image.values.size());
        int worst = 0;
        for (std::size_t i = 0; i < back.values.size(); ++i)
            worst = std::max(worst, std::abs(int(back.values[i]) - int(image.values[i])));
        CHECK(worst <= 6);
        const ImageHeader header = read_image_header(path);
        CHECK(header.width == 40);
        CHECK(header.height == 24);
        CHECK(header.channels == channels);
        CHECK(read_image8(path, 1).channels == 1);
        CHECK(read_image8(path, 3).values.size() == 40 * 24 * 3);
    }
    CHECK_FAULT(write_jpeg(path, pattern(4, 4, 4), 95), "a.jpg: got an image of 4 channels");
}

TEST_CASE("image: a JPEG cut anywhere is refused, one damaged anywhere never crashes") {
    const TemporaryFolder folder;
    const fs::path path = folder.path / "a.jpg";
    write_jpeg(path, pattern(33, 17, 3), 80);
    const Bytes whole = read_file(path);
    for (std::size_t n = 0; n < whole.size(); n += 3)
        CHECK_FAULT(decode_image(ByteSpan(whole).first(n), "cut.jpg"), "cut.jpg: ");
    for (std::size_t i = 0; i < whole.size(); ++i)
        for (const int flip : {1, 16, 255}) {
            Bytes damaged = whole;
            damaged[i] ^= static_cast<std::byte>(flip);
            std::string told = "damaged.jpg";
            try { // without a checksum, any decoded pixels are valid
                decode_image(damaged, "damaged.jpg");
            } catch (const Error& e) {
                told = e.what();
            }
            CHECK(told.find("damaged.jpg") != std::string::npos);
        }
}

TEST_CASE("image: a small JPEG that claims 8192 x 8192 pixels costs neither memory nor time") {
    for (const int channels : {1, 3}) {
        Bytes bomb = read_jpeg_bytes(channels);
        CHECK(bomb.size() < 2000);
        const std::size_t frame = as_text(bomb).find("\xff\xc0");
        REQUIRE(frame != std::string_view::npos);
        for (const std::size_t at : {5U, 7U}) { // height and width, big-endian
            bomb[frame + at] = std::byte(0x20);
            bomb[frame + at + 1] = std::byte(0);
        }
        struct rusage before {}, after{};
        ::getrusage(RUSAGE_SELF, &before);
        CHECK_FAULT(decode_image(bomb, "bomb.jpg"), "bomb.jpg: JPEG: truncated");
        bomb[frame + 1] = std::byte(0xc2); // progressive: all coefficients are in memory at once
        CHECK_FAULT(decode_image(bomb, "bomb.jpg"), "bomb.jpg: ");
        ::getrusage(RUSAGE_SELF, &after);
        CHECK(after.ru_maxrss - before.ru_maxrss < 32768); // [kB]
        bomb[frame + 5] = bomb[frame + 7] = std::byte(0x40);
        bomb[frame + 8] = std::byte(1);
        CHECK_FAULT(decode_image(bomb, "bomb.jpg"), "expected 1 to 16384 a side");
    }
}

TEST_CASE("image: a small PNG that claims 8192 x 8192 pixels costs no memory") {
    Bytes bomb = png_of(8192, 8192, 8, 2, Bytes(20));
    struct rusage before {}, after{};
    ::getrusage(RUSAGE_SELF, &before);
    CHECK_FAULT(decode_image(bomb, "bomb.png"), "too few to hold them");
    ::getrusage(RUSAGE_SELF, &after);
    CHECK(after.ru_maxrss - before.ru_maxrss < 32768); // [kB]
}

TEST_CASE("image: PNGs of 16 bits, of 1 bit, with a palette and with a transparent colour") {
    const auto decoded = [](const Bytes& png) { return decode_image(png, "a.png"); };
    // 16 bits are rounded to 8: 0x0080 is 0.498 of a step, 0x00ff nearly 1.
    const Image8 deep = decoded(png_of(3, 1, 16, 0, of({0, 0x00, 0x80, 0x00, 0xff, 0xff, 0xff})));
    CHECK(deep.values == std::vector<std::uint8_t>{0, 1, 255});
    const Image8 bits = decoded(png_of(4, 1, 1, 0, of({0, 0b10100000})));
    CHECK(bits.channels == 1);
    CHECK(bits.values == std::vector<std::uint8_t>{255, 0, 255, 0});
    const Bytes palette = chunk("PLTE", of({1, 2, 3, 40, 50, 60}));
    const Image8 indexed = decoded(png_of(2, 1, 8, 3, of({0, 1, 0}), palette));
    CHECK(indexed.channels == 3);
    CHECK(indexed.values == std::vector<std::uint8_t>{40, 50, 60, 1, 2, 3});
    Bytes transparent = palette;
    append(transparent, chunk("tRNS", of({7})));
    const Image8 rgba = decoded(png_of(2, 1, 8, 3, of({0, 1, 0}), transparent));
    CHECK(rgba.channels == 4);
    CHECK(rgba.values == std::vector<std::uint8_t>{40, 50, 60, 255, 1, 2, 3, 7});
    CHECK_FAULT(decoded(png_of(2, 1, 8, 3, of({0, 1, 0}))), "a.png: PNG: ");
}

TEST_CASE("image: a JPEG of four inks is refused by name, a pipe is not waited for") {
    // Adobe's segment says CMYK; four components of one block each.
    Bytes cmyk = of({0xff, 0xd8, 0xff, 0xee, 0, 14, 'A', 'd', 'o', 'b', 'e', 0, 100, 0, 0, 0, 0, 0,
                     0xff, 0xc0, 0, 20, 8, 0, 8, 0, 8, 4, 1, 0x11, 0, 2, 0x11, 0, 3, 0x11, 0, 4,
                     0x11, 0, 0xff, 0xda, 0, 14, 4, 1, 0, 2, 0, 3, 0, 4, 0, 0, 63, 0, 0xff, 0xd9});
    CHECK_FAULT(decode_image(cmyk, "four.jpg"), "four.jpg: got a JPEG of 4 channels (CMYK");
    const TemporaryFolder folder;
    const fs::path pipe = folder.path / "pipe.png";
    REQUIRE(::mkfifo(pipe.c_str(), 0600) == 0);
    CHECK_FAULT(read_image_header(pipe), "pipe.png: not a file");
    CHECK_FAULT(read_image8(pipe), "pipe.png: not a file");
}

TEST_CASE("image: a real JPEG, whole and cut") {
    const auto source = test::real_data("capture_a/images/0000/image_08.jpg");
    if (!source) return;
    const Image8 image = read_image8(*source, 3);
    CHECK(image.width == 256);
    CHECK(image.values.size() == 3 * 256 * 256);
    const TemporaryFolder folder;
    const fs::path path = folder.path / "cut.jpg";
    const Bytes whole = read_file(*source);
    for (const double share : {0.01, 0.3, 0.7, 0.999}) {
        const auto n = static_cast<std::size_t>(share * static_cast<double>(whole.size()));
        write_atomic(path, ByteSpan(whole).first(n));
        CHECK_FAULT(read_image8(path, 3), "cut.jpg: ");
    }
}
