// SPDX-License-Identifier: Apache-2.0
#include <rye/io/npz.hpp>

#include <cstring>
#include <filesystem>
#include <string>
#include <string_view>

#include <doctest/doctest.h>

#include "../support/hostile.hpp"

using namespace rye;

namespace {

Bytes from_hex(std::string_view hex) {
    Bytes out;
    for (std::size_t i = 0; i + 1 < hex.size(); i += 2)
        out.push_back(
            static_cast<std::byte>(std::stoi(std::string(hex.substr(i, 2)), nullptr, 16)));
    return out;
}

/// 600 throws of a five-sided die, which zlib packs with dynamic codes.
std::vector<std::uint8_t> throws_of_a_die() {
    std::vector<std::uint8_t> out;
    std::uint32_t x = 1;
    for (int k = 0; k < 600; ++k) {
        x = (x * 1103515245U + 12345U) % 0x80000000U;
        out.push_back(static_cast<std::uint8_t>((x >> 16U) % 5U));
    }
    return out;
}

/// Written by Python's zipfile: deflated, with zip64 fields in the local headers.
/// dice.npy is uint8 (600,), pi.npy is the float64 3.25.
constexpr std::string_view deflated_npz =
    "504b03042d000000080000002100db847b67ffffffffffffffff08001400646963652e6e707901001000d802"
    "0000000000005a010000000000009d92394ec300104567ab38853b83942234141c800e444341852262448148"
    "64030d700a2eccfb634e409444ce2c7f9bfcdcdc5ddfdebb7dd8e7b89f96c779bc1cc6aff7f371338c4f87f9"
    "6ddebd3e1ce6fda4fad5ee6599a82fcfbbe3c4efd38bed7673b619be877fbf4e32d33cacc22bca2c2bc35da5"
    "72a3a64654524aa3c3a7d298c908965203949c06fb6eae961b054a56051e43c20e734680613f69510c6860b1"
    "e8b7a6f5edd4a3224b0bfd944263935f1ed145309a142d120771360090811c3e3ccb0634eb22caaa0abd4607"
    "5750490fb25c6601100f0348cdd01462812315e8026f4082c0a8005c41a96750c922f0702149edea50804919"
    "57ae2ed79289110545324481f194e81e471d5e3315acd42964a1b1a51d15c5d8eea47b856dc6545939f4b2af"
    "1b4a58974d59fa3bd8ea1fe3c0d6eab16f2ca6357b0d022d9fd9b7070223fa77c8b76ed7d70c05abab5adb76"
    "d95080297528fd05504b03042d000000080000002100bb99b90dffffffffffffffff0600140070692e6e7079"
    "01001000880000000000000047000000000000009bec17ea1b10c9c850c650ad9e925a9c5ca46ea5a06e9366"
    "a1aea3a09e965f54529498179f5f94920a12774bcc294e058a17672416a402f91a9a3a0ab50a14012e0630e0"
    "720000504b01022d032d000000080000002100db847b675a010000d802000008000000000000000000000080"
    "0100000000646963652e6e7079504b01022d032d000000080000002100bb99b90d4700000088000000060000"
    "00000000000000000080019401000070692e6e7079504b050600000000020002006a000000130200000000";

/// bytes 0 to 39, three times, by zlib with the fixed code and without compression.
constexpr std::string_view fixed_block =
    "6360646266616563e7e0e4e2e6e1e5e317101412161115139790949296919593575054525651555367a0b23a"
    "00";
constexpr std::string_view stored_block =
    "01780087ff000102030405060708090a0b0c0d0e0f101112131415161718191a1b1c1d1e1f20212223242526"
    "27000102030405060708090a0b0c0d0e0f101112131415161718191a1b1c1d1e1f2021222324252627000102"
    "030405060708090a0b0c0d0e0f101112131415161718191a1b1c1d1e1f2021222324252627";

NpzArrays two_arrays() {
    const Columns<double> points = Columns<double>::Random(3, 5);
    const std::vector<std::int32_t> counts{1, -2, 3};
    return {{"points", npy_array(points)}, {"counts", npy_array<std::int32_t>({3}, counts)}};
}

} // namespace

TEST_CASE("npz: what is written is read back, bit by bit") {
    const NpzArrays arrays = two_arrays();
    const NpzArrays back = parse_npz(npz_bytes(arrays), "a.npz");
    REQUIRE(back.size() == 2);
    for (const auto& [name, array] : arrays) {
        CHECK(back.at(name).shape == array.shape);
        CHECK(back.at(name).type() == array.type());
        CHECK(back.at(name).bytes == array.bytes);
    }
    CHECK(parse_npz(npz_bytes({}), "empty.npz").empty());
}

TEST_CASE("npz: deflated members and zip64 local headers, as NumPy writes them") {
    const NpzArrays arrays = parse_npz(from_hex(deflated_npz), "dice.npz");
    REQUIRE(arrays.size() == 2);
    CHECK(arrays.at("dice").values<std::uint8_t>("dice") == throws_of_a_die());
    CHECK(arrays.at("pi").shape.empty());
    CHECK(arrays.at("pi").values<double>("pi") == std::vector<double>{3.25});
}

TEST_CASE("inflate: the fixed code and stored blocks") {
    for (const std::string_view block : {fixed_block, stored_block}) {
        const Bytes out = inflate(from_hex(block), 120, "block");
        for (std::size_t i = 0; i < 120; ++i) CHECK(static_cast<std::size_t>(out[i]) == i % 40);
    }
}

TEST_CASE("inflate: never more than declared, never less") {
    const Bytes block = from_hex(fixed_block);
    CHECK_FAULT(inflate(block, 119, "bomb"), "more than the declared 119");
    CHECK_FAULT(inflate(block, 121, "short"), "got 120 bytes, expected 121");
    CHECK_FAULT(inflate(block, std::uint64_t(1) << 40U, "bomb"), "cannot hold the declared");
    for (std::size_t n = 0; n < block.size(); ++n)
        CHECK_THROWS_AS(inflate(ByteSpan(block).first(n), 120, "cut"), Error);
    CHECK_FAULT(inflate(from_hex("07"), 0, "type 3"), "unknown block type");
}

TEST_CASE("crc32: the check value of its catalogue entry") {
    CHECK(crc32(as_bytes("123456789")) == 0xCBF43926U);
}

TEST_CASE("npz: truncated anywhere, it is refused with the file's name") {
    for (const Bytes& whole : {npz_bytes(two_arrays()), from_hex(deflated_npz)})
        for (std::size_t n = 0; n < whole.size(); n += n < 64 ? 1 : 7)
            CHECK_FAULT(parse_npz(ByteSpan(whole).first(n), "cut.npz"), "cut.npz");
}

TEST_CASE("npz: any damaged byte is an Error or changes nothing, never a crash") {
    for (const Bytes& whole : {npz_bytes(two_arrays()), from_hex(deflated_npz)}) {
        const NpzArrays truth = parse_npz(whole, "whole.npz");
        for (std::size_t i = 0; i < whole.size(); ++i)
            for (const int flip : {1, 128, 255}) {
                Bytes damaged = whole;
                damaged[i] ^= static_cast<std::byte>(flip);
                try {
                    // Names and dates have no checksum; numbers do.
                    for (const auto& [name, array] : parse_npz(damaged, "damaged.npz"))
                        if (truth.count(name) != 0) CHECK(array.bytes == truth.at(name).bytes);
                } catch (const Error& e) {
                    CHECK(std::string(e.what()).find("damaged.npz") != std::string::npos);
                }
            }
    }
}

TEST_CASE("npz: lies about sizes are refused before memory is asked for") {
    Bytes zip = npz_bytes({{"a", two_arrays().at("points")}});
    const std::size_t directory = zip.size() - 22 - 46 - 5;
    const auto set32 = [&](std::size_t at, std::uint32_t value) {
        std::memcpy(zip.data() + at, &value, 4);
    };
    set32(directory + 24, 0xF0000000U); // unpacked
    CHECK_FAULT(parse_npz(zip, "a.npz"), "two sizes differ");
    zip[directory + 10] = std::byte(8); // deflate
    CHECK_FAULT(parse_npz(zip, "a.npz"), "cannot hold the declared");
    zip[directory + 10] = std::byte(12); // bzip2
    CHECK_FAULT(parse_npz(zip, "a.npz"), "got zip method 12");
    set32(directory + 24, 0xFFFFFFFFU); // states a zip64 field
    CHECK_FAULT(parse_npz(zip, "a.npz"), "zip64 field of 'a.npy' is missing");
}

TEST_CASE("npz: files") {
    const TemporaryFolder folder;
    const std::filesystem::path path = folder.path / "a.npz";
    write_npz(path, two_arrays());
    CHECK(read_npz(path).at("points").shape == std::vector<Index>{5, 3});
    CHECK_FAULT(read_npz(folder.path / "b.npz"), "b.npz: no such file");
    CHECK_FAULT(read_npz(folder.path), "not a file");
    write_atomic(path, {});
    CHECK_FAULT(read_npz(path), "a.npz: truncated: got 0 bytes");
}

TEST_CASE("npz: members that share bytes are refused before any is unpacked") {
    // A directory that lists one member forty times, each time under another name.
    const Bytes one = npz_bytes({{"a0", two_arrays().at("points")}});
    const std::size_t entry = 46 + 6, directory = one.size() - 22 - entry;
    Bytes zip(one.begin(), one.begin() + static_cast<std::ptrdiff_t>(directory));
    for (int i = 0; i < 40; ++i) {
        append(zip, ByteSpan(one).subspan(directory, entry));
        zip[zip.size() - 6] = static_cast<std::byte>('A' + i);
    }
    append(zip, ByteSpan(one).last(22));
    const std::uint16_t count = 40;
    for (const std::size_t at : {12U, 14U}) std::memcpy(zip.data() + zip.size() - at, &count, 2);
    const auto bytes = static_cast<std::uint32_t>(count * entry);
    std::memcpy(zip.data() + zip.size() - 10, &bytes, 4);
    CHECK(parse_npz(one, "one.npz").size() == 1);
    CHECK_FAULT(parse_npz(zip, "forty.npz"), "forty.npz: two of its 40 members overlap");
}

TEST_CASE("npz: a flipped bit is refused, or changes nothing that is read") {
    const NpzArrays right = two_arrays();
    const Bytes whole = npz_bytes(right);
    for (std::size_t bit = 0; bit < 8 * whole.size(); ++bit) {
        Bytes damaged = whole;
        damaged[bit / 8] ^= static_cast<std::byte>(1U << (bit % 8));
        try {
            const NpzArrays read = parse_npz(damaged, "a.npz");
            INFO(bit);
            REQUIRE(read.size() == right.size());
            for (const auto& [name, array] : right) {
                REQUIRE(read.count(name) == 1);
                CHECK(read.at(name).bytes == array.bytes);
                CHECK(read.at(name).shape == array.shape);
            }
        } catch (const Error& e) {
            CHECK(std::string(e.what()).starts_with("a.npz"));
        }
    }
}
