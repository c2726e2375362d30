// SPDX-License-Identifier: Apache-2.0
#include <rye/io/png.hpp>

#include <array>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <vector>

#include <doctest/doctest.h>

#include <rye/io/atomic_file.hpp>
#include <rye/io/gzip.hpp>

#include "../support/hostile.hpp"

using namespace rye;

namespace {

using Values = std::vector<std::uint8_t>;

void put(Bytes& to, std::uint32_t x) {
    for (const unsigned shift : {24U, 16U, 8U, 0U}) append(to, static_cast<std::uint8_t>(x >> shift));
}
void put_chunk(Bytes& to, const std::string& kind, ByteSpan data) {
    put(to, static_cast<std::uint32_t>(data.size()));
    const std::size_t begin = to.size();
    append(to, as_bytes(kind));
    append(to, data);
    put(to, crc32(ByteSpan(to).subspan(begin)));
}

/// The parts of a PNG of 5 x 6 pixels.
struct Png {
    static constexpr std::uint32_t width = 5, height = 6;
    std::uint32_t stated_width = width;
    std::uint8_t depth = 8, colour = 0, interlaced = 0;
    Values palette = {};
    std::string kind = {};  // of a chunk before the pixels
    std::uint32_t adler_off = 0;

    /// The file; `rows` has a filter before each row.
    Bytes file(const Values& rows) const {
        Bytes out, header, zlib;
        append(out, as_bytes("\x89PNG\r\n\x1a\n"));
        put(header, stated_width);
        put(header, height);
        for (const std::uint8_t b : {depth, colour, std::uint8_t(0), std::uint8_t(0), interlaced})
            append(header, b);
        put_chunk(out, "IHDR", header);
        if (!palette.empty()) put_chunk(out, "PLTE", std::as_bytes(std::span(palette)));
        if (!kind.empty()) put_chunk(out, kind, as_bytes("abc"));
        append(zlib, as_bytes("\x78\x01"));
        const ByteSpan raw = std::as_bytes(std::span(rows));
        append(zlib, ByteSpan(stored_deflate(raw)));
        put(zlib, detail::adler32(raw) + adler_off);
        // In two chunks, as large files are.
        put_chunk(out, "IDAT", ByteSpan(zlib).first(9));
        put_chunk(out, "IDAT", ByteSpan(zlib).subspan(9));
        put_chunk(out, "IEND", {});
        return out;
    }
};

/// Any values, the rows of an image of so many channels.
Values some_values(std::size_t channels) {
    Values v;
    for (std::size_t i = 0; i < Png::width * Png::height * channels; ++i)
        v.push_back(static_cast<std::uint8_t>(i * i * 31 + i / 7));
    return v;
}

/// The predicted value as the specification defines it.
int predicted(int filter, int a, int b, int c) {
    if (filter == 0) return 0;
    if (filter == 1) return a;
    if (filter == 2) return b;
    if (filter == 3) return (a + b) / 2;
    const int p = a + b - c, pa = std::abs(p - a), pb = std::abs(p - b), pc = std::abs(p - c);
    if (pa <= pb && pa <= pc) return a;
    return pb <= pc ? b : c;
}

/// Rows with filters: row y has filter (first + y) % 5.
Values filtered(const Values& v, std::size_t channels, std::size_t first) {
    const std::size_t row = Png::width * channels;
    Values out;
    for (std::size_t y = 0; y < Png::height; ++y) {
        const int filter = static_cast<int>((first + y) % 5);
        out.push_back(static_cast<std::uint8_t>(filter));
        for (std::size_t i = 0; i < row; ++i) {
            const std::size_t at = y * row + i;
            const int a = i < channels ? 0 : v[at - channels], b = y == 0 ? 0 : v[at - row];
            const int c = i < channels || y == 0 ? 0 : v[at - row - channels];
            out.push_back(static_cast<std::uint8_t>(v[at] - predicted(filter, a, b, c)));
        }
    }
    return out;
}

constexpr std::array<std::uint8_t, 5> colour_of{255, 0, 4, 2, 6};  // by channels

} // namespace

TEST_CASE("png: 1 to 4 channels by every filter") {
    for (std::size_t channels = 1; channels <= 4; ++channels)
        for (std::size_t first = 0; first < 5; ++first) {
            const Values v = some_values(channels);
            const Image8 got =
                parse_png(Png{.colour = colour_of[channels]}.file(filtered(v, channels, first)), "a");
            CHECK(got.width == 5);
            CHECK(got.height == 6);
            CHECK(got.channels == static_cast<int>(channels));
            CHECK(got.values == v);
        }
}

TEST_CASE("png: a palette") {
    Values indices = some_values(1), colours(3 * 256), expected;
    for (std::size_t i = 0; i < colours.size(); ++i)
        colours[i] = static_cast<std::uint8_t>(i * 7 + 1);
    for (const std::size_t i : indices)
        expected.insert(expected.end(), {colours[3 * i], colours[3 * i + 1], colours[3 * i + 2]});
    Png png{.colour = 3, .palette = colours};
    CHECK(parse_png(png.file(filtered(indices, 1, 0)), "a").values == expected);
    png.palette.resize(3 * 100);
    CHECK_FAULT(parse_png(png.file(filtered(indices, 1, 0)), "a.png"), "of a palette of 100");
}

TEST_CASE("png: every changed bit and every truncation is an error that names the file") {
    const Bytes file = Png{.colour = 2}.file(filtered(some_values(3), 3, 0));
    for (std::size_t i = 0; i < file.size(); ++i)
        for (const unsigned bit : {0U, 5U}) {
            Bytes damaged = file;
            damaged[i] ^= static_cast<std::byte>(1U << bit);
            CHECK_FAULT(parse_png(damaged, "a.png"), "a.png: ");
        }
    for (std::size_t n = 0; n < file.size(); ++n)
        CHECK_FAULT(parse_png(ByteSpan(file).first(n), "a.png"), "a.png: ");
}

TEST_CASE("png: kinds that are not read") {
    const Values rows = filtered(some_values(1), 1, 0);
    CHECK_FAULT(parse_png(as_bytes("\xff\xd8\xff"), "a.jpg"), "a.jpg: not a PNG by its first bytes");
    CHECK_FAULT(parse_png(Png{.depth = 16}.file(rows), "a.png"),
                "a.png: PNG: got 16 bits a channel, expected 8");
    CHECK_FAULT(parse_png(Png{.colour = 5}.file(rows), "a.png"), "got colour type 5");
    CHECK_FAULT(parse_png(Png{.interlaced = 1}.file(rows), "a.png"), "interlacing 1");
    CHECK_FAULT(parse_png(Png{.kind = "ABCD"}.file(rows), "a.png"), "the unknown chunk 'ABCD'");
    CHECK_NOTHROW(parse_png(Png{.kind = "tEXt"}.file(rows), "a.png"));
    CHECK_FAULT(parse_png(Png{.stated_width = 0}.file(rows), "a.png"), "an image of 0 x 6 pixels");
    CHECK_FAULT(parse_png(Png{.stated_width = 1U << 31U}.file(rows), "a.png"), "expected 1 to 16384");
    CHECK_FAULT(parse_png(Png{.stated_width = 6}.file(rows), "a.png"), "got 36 bytes, expected 42");
    CHECK_FAULT(parse_png(Png{.stated_width = 16000}.file(rows), "a.png"), "cannot hold");
    CHECK_FAULT(parse_png(Png{.adler_off = 1}.file(rows), "a.png"), "checksum of its pixels");
    CHECK_FAULT(parse_png(Png{}.file(rows), "a.png", 50), "its 5 x 6 pixels would take 72 bytes");
    Values other = rows;
    other[6] = 5;
    CHECK_FAULT(parse_png(Png{}.file(other), "a.png"), "row 1 has filter 5");
}

TEST_CASE("png: files, as a reader of a capture's pictures") {
    const TemporaryFolder folder;
    const auto path = folder.path / "a.png";
    const Values v = some_values(3);
    write_atomic(path, Png{.colour = 2}.file(filtered(v, 3, 1)));
    const PngFiles files;
    CHECK(files.header(path).width == 5);
    CHECK(files.header(path).channels == 3);
    CHECK(files.read(path, 3).values == v);
    CHECK(files.read(path, 1).values[2] == (77 * v[6] + 150 * v[7] + 29 * v[8]) / 256);
    CHECK_FAULT(files.read(folder.path / "b.png", 3), "b.png: no such file");
}
