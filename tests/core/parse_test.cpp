// SPDX-License-Identifier: Apache-2.0
#include <rye/core/parse.hpp>

#include <clocale>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <initializer_list>
#include <limits>
#include <string>

#include <doctest/doctest.h>

#include <rye/core/bit_cast.hpp>
#include <rye/core/random.hpp>

using namespace rye;

namespace {

/// Both implementations, of which a standard library needs one; empty where they differ.
std::optional<double> both(const std::string& text) {
    const auto x = parse_double(text);
#if !defined(_WIN32)
    const auto y = detail::parse_by_strtod(text);
    CHECK_MESSAGE(x.has_value() == y.has_value(), text);
    if (x && y && !std::isnan(*x))
        CHECK_MESSAGE(bit_cast<std::uint64_t>(*x) == bit_cast<std::uint64_t>(*y), text);
#endif
    return x;
}

/// A double of any bits, written with 17 digits.
std::string written(double x) {
    char text[40];
    std::snprintf(text, sizeof text, "%.17g", x);
    return text;
}

} // namespace

TEST_CASE("parse: the nearest double") {
    CHECK(both("1") == 1.0);
    CHECK(both("-0.1") == -0.1);
    CHECK(both(".5") == 0.5);
    CHECK(both("5.") == 5.0);
    CHECK(both("1E+3") == 1000.0);
    CHECK(both("0x") == std::nullopt);
    CHECK(std::signbit(both("-0").value()));
    CHECK(both("9007199254740993") == 9007199254740992.0);     // a tie: to even
    CHECK(both("9007199254740993.0000000000000000000000000001") == 9007199254740994.0);
    CHECK(both("0.1000000000000000055511151231257827021181583404541015625") == 0.1);
    CHECK(both("1.7976931348623157e308") == std::numeric_limits<double>::max());
    CHECK(both("2.2250738585072014e-308") == std::numeric_limits<double>::min());
    CHECK(both("inf") == std::numeric_limits<double>::infinity());
    CHECK(both("-Infinity") == -std::numeric_limits<double>::infinity());
    CHECK(std::isnan(both("nan").value()));
}

TEST_CASE("parse: whatever double is written is read back") {
    const Random random{7, 0};
    for (std::uint64_t i = 0; i < 20000; ++i) {
        const std::uint64_t bits = random.bits(i);
        const auto x = bit_cast<double>(bits);
        if (!std::isfinite(x)) continue;
        const auto y = both(written(x));
        REQUIRE(y.has_value());
        REQUIRE(bit_cast<std::uint64_t>(*y) == bits);
    }
}

TEST_CASE("parse: what is no number, or none that a double holds") {
    for (const char* text : {"", "-", "+1", " 1", "1 ", "--1", "- 1", "-+1", ".", "e5", "1e", "1e+",
                             "1,5", "1_0", "0x10", "0X1p3", "one", "1..2", "1e400", "-1e400",
                             "1e-400", "1e99999999999", "infinit", "in", "\n1", "1\n"})
        CHECK_MESSAGE(!both(text).has_value(), text);
    CHECK(!both(std::string("1\0", 2)).has_value());
    CHECK(!both(std::string("\0", 1)).has_value());
}

TEST_CASE("parse: the same with a decimal comma in the program's locale") {
    const char* found = nullptr;
    for (const char* name : {"de_DE.UTF-8", "de_DE.utf8", "fr_FR.UTF-8", "nb_NO.UTF-8"})
        if (found == nullptr) found = std::setlocale(LC_ALL, name);
    if (found == nullptr) MESSAGE("no locale with a decimal comma on this machine");
    CHECK(both("1.5") == 1.5);
    CHECK(!both("1,5").has_value());
    std::setlocale(LC_ALL, "C");
}
