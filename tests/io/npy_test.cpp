// SPDX-License-Identifier: Apache-2.0
#include <rye/io/npy.hpp>

#include <cmath>
#include <limits>
#include <string>

#include <doctest/doctest.h>

#include "../support/hostile.hpp"

using namespace rye;

namespace {

/// A version 1 file with this header text and these numbers.
template <class T>
Bytes file_with(const std::string& header, const std::vector<T>& numbers) {
    Bytes out;
    append(out, as_bytes(std::string_view("\x93NUMPY\x01\x00", 8)));
    append(out, static_cast<std::uint16_t>(header.size()));
    append(out, as_bytes(header));
    for (const T& x : numbers) append(out, x);
    return out;
}

std::string dict(const std::string& descr, const std::string& order, const std::string& shape) {
    return "{'descr': '" + descr + "', 'fortran_order': " + order + ", 'shape': " + shape + ", }\n";
}

} // namespace

TEST_CASE("npy: columns are written as rows of points and read back, data on 64 bytes") {
    const Columns<float> points = Columns<float>::Random(3, 7);
    const Bytes bytes = npy_bytes(npy_array(points));
    CHECK((bytes.size() - 3 * 7 * 4) % 64 == 0);
    const NpyArray array = parse_npy(bytes, "points.npy");
    CHECK(array.shape == std::vector<Index>{7, 3});
    CHECK(array.type() == "f4");
    const std::vector<float> values = array.values<float>("points.npy");
    CHECK(Eigen::Map<const Columns<float>>(values.data(), 3, 7) == points);
}

TEST_CASE("npy: every numeric type, empty arrays and single numbers") {
    const auto round_trip = []<class T>(T) {
        const std::vector<T> in{T(0), T(1), std::numeric_limits<T>::max(),
                                std::numeric_limits<T>::lowest()};
        const NpyArray array = parse_npy(npy_bytes(npy_array<T>({2, 2}, in)), "a.npy");
        CHECK(array.values<T>("a.npy") == in);
    };
    round_trip(std::int8_t());
    round_trip(std::uint8_t());
    round_trip(std::int16_t());
    round_trip(std::uint16_t());
    round_trip(std::int32_t());
    round_trip(std::uint32_t());
    round_trip(std::int64_t());
    round_trip(std::uint64_t());
    round_trip(float());
    round_trip(double());
    CHECK(parse_npy(npy_bytes(npy_array(Columns<double>(3, 0))), "a.npy").size() == 0);
    const std::vector<double> one{0.1};
    CHECK(parse_npy(npy_bytes(npy_array<double>({}, one)), "a.npy").values<double>("a") == one);
}

TEST_CASE("npy: Fortran order and big-endian become C order and little-endian") {
    const std::vector<float> by_columns{1, 4, 2, 5, 3, 6};
    const NpyArray array = parse_npy(file_with(dict("<f4", "True", "(2, 3)"), by_columns), "a");
    CHECK(array.values<double>("a") == std::vector<double>{1, 2, 3, 4, 5, 6});
    const std::vector<std::uint16_t> swapped{0x0100, 0x0201};
    CHECK(parse_npy(file_with(dict(">u2", "False", "(2,)"), swapped), "a").values<int>("a") ==
          std::vector<int>{1, 0x0102});
    std::vector<std::int32_t> cube(24); // element (i, j, k) = 100 i + 10 j + k
    for (int k = 0, n = 0; k < 4; ++k)
        for (int j = 0; j < 3; ++j)
            for (int i = 0; i < 2; ++i) cube[static_cast<std::size_t>(n++)] = 100 * i + 10 * j + k;
    const auto c =
        parse_npy(file_with(dict("<i4", "True", "(2, 3, 4)"), cube), "a").values<int>("a");
    CHECK(c[0] == 0);
    CHECK(c[1] == 1);
    CHECK(c[4] == 10);
    CHECK(c[12] == 100);
    CHECK(c[23] == 123);
}

TEST_CASE("npy: conversions that lose the number are refused") {
    const std::vector<double> values{0.5};
    const NpyArray half = npy_array<double>({1}, values);
    CHECK_FAULT(half.values<int>("half"), "half: number 0 does not fit");
    CHECK(half.values<float>("half") == std::vector<float>{0.5f});
    for (const double bad : {double(NAN), double(INFINITY), 300.0, -1.0, 1e30}) {
        const std::vector<double> one{bad};
        CHECK_THROWS_AS(npy_array<double>({1}, one).values<std::uint8_t>("bad"), Error);
    }
    const std::vector<double> wide{1e300};
    CHECK_FAULT(npy_array<double>({1}, wide).values<float>("wide"), "wide: number 0 does not fit");
    const std::vector<std::int64_t> big{std::int64_t(1) << 40U};
    CHECK_THROWS_AS(npy_array<std::int64_t>({1}, big).values<std::int32_t>("big"), Error);
}

TEST_CASE("npy: hostile headers are one sentence that names the file") {
    const std::vector<double> one{1.0};
    const auto parse = [&](const std::string& header) {
        return parse_npy(file_with(header, one), "x.npy");
    };
    CHECK(parse(dict("<f8", "False", "(1,)")).size() == 1);
    CHECK(parse(dict("<f8", "False", "()")).size() == 1);
    CHECK_FAULT(parse(dict("<f8", "False", "(2,)")),
                "x.npy: shape (2,) of f8 needs 16 bytes, got 8");
    CHECK_FAULT(parse(dict("<f8", "False", "(0,)")), "needs 0 bytes, got 8");
    CHECK_FAULT(parse(dict("<f8", "False", "(-1,)")), "extent is not a count");
    CHECK_FAULT(parse(dict("<f8", "False", "(1e9,)")), "expected ')'");
    CHECK_FAULT(parse(dict("<f8", "False", "(4294967296, 4294967296, 2)")), "overflows");
    CHECK_FAULT(parse(dict("<f8", "False", "(9223372036854775807,)")), "overflows");
    // An extent of 0 gives no bytes, but only after the others have been multiplied.
    for (const char* shape : {"(4611686018427387904, 2, 0)", "(0, 4611686018427387904, 2)"})
        CHECK_FAULT(parse_npy(file_with<char>(dict("|u1", "False", shape), {}), "x.npy"),
                    "overflows");
    CHECK(parse_npy(file_with<char>(dict("<f8", "False", "(3, 0)"), {}), "x.npy").size() == 0);
    CHECK_FAULT(parse(dict("<f8", "False", "(99999999999999999999,)")), "extent is not a count");
    CHECK_FAULT(parse(dict("<f8", "False", "(1,1,1,1,1,1,1,1,1)")), "more than 8 extents");
    CHECK_FAULT(parse(dict("|O", "False", "(1,)")), "got dtype '|O'");
    CHECK_FAULT(parse(dict("<U8", "False", "(1,)")), "got dtype '<U8'");
    CHECK_FAULT(parse(dict("", "False", "(1,)")), "got dtype ''");
    CHECK_FAULT(parse(dict("<f8", "Maybe", "(1,)")), "neither True nor False");
    CHECK_FAULT(parse("{'descr': [('x', '<f8')], 'fortran_order': False, 'shape': (1,)}"),
                "record");
    CHECK_FAULT(parse("{'descr': '<f8', 'shape': (1,)}"), "is missing");
    CHECK_FAULT(parse("{'descr': '<f8', 'descr': '<f4'}"), "unknown or repeated");
    CHECK_FAULT(parse("{'descr"), "does not end");
    CHECK_FAULT(parse(""), "expected '{'");
    CHECK_FAULT(parse(dict("<f8", "False", "(1,)") + "x"), "text follows");
    CHECK_FAULT(parse_npy(as_bytes("PK\x03\x04 this is a zip"), "x.npy"), "not an npy array");
    CHECK_FAULT(parse_npy({}, "x.npy"), "x.npy: truncated");
}

TEST_CASE("npy: a header bomb is refused by its length") {
    Bytes bytes;
    append(bytes, as_bytes(std::string_view("\x93NUMPY\x02\x00", 8)));
    append(bytes, std::uint32_t(0xFFFFFFFFU));
    CHECK_FAULT(parse_npy(bytes, "bomb.npy"), "bomb.npy: got an npy header of 4294967295 bytes");
    Bytes nine;
    append(nine, as_bytes(std::string_view("\x93NUMPY\x09\x00\x00\x00", 10)));
    CHECK_FAULT(parse_npy(nine, "v9.npy"), "got npy version 9");
}

TEST_CASE("npy: truncated anywhere, it is refused") {
    const Bytes whole = npy_bytes(npy_array(Columns<double>::Random(3, 4).eval()));
    for (std::size_t n = 0; n < whole.size(); ++n)
        CHECK_FAULT(parse_npy(ByteSpan(whole).first(n), "cut.npy"), "cut.npy");
}
