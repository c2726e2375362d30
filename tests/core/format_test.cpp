// SPDX-License-Identifier: Apache-2.0
// Numbers to text and back, by both implementations, of which a standard library needs one.
#include <rye/core/format.hpp>

#include <cmath>
#include <cstdint>
#include <limits>
#include <string>

#include <doctest/doctest.h>

#include <rye/core/bit_cast.hpp>
#include <rye/core/parse.hpp>
#include <rye/core/random.hpp>

#include "../support/locales.hpp"

using namespace rye;

namespace {

template <class T>
void check_read_back(T x) {
    for (const std::string& text : {number_text(x), detail::format_by_snprintf(x)}) {
        INFO(text);
        const auto back = parse_double(text);
        REQUIRE(back.has_value());
        if (std::isnan(x)) {
            CHECK(std::isnan(*back));
        } else {
            CHECK(static_cast<T>(*back) == x);
            CHECK(std::signbit(*back) == std::signbit(x));
        }
    }
    CHECK(number_text(x).size() <= detail::format_by_snprintf(x).size() + 1);
}

void check_all() {
    CHECK(number_text(0.1) == "0.1");
    CHECK(detail::format_by_snprintf(0.1) == "0.1");
    CHECK(number_text(0.1F) == "0.1");
    CHECK(detail::format_by_snprintf(0.1F) == "0.1");
    CHECK(detail::format_by_snprintf(1234567.25) == "1234567.25");
    CHECK(number_text(1234567.25) == "1234567.25");
    CHECK(number_text(std::int64_t(-1234567)) == "-1234567");
    CHECK(number_text(std::numeric_limits<double>::infinity()) == "inf");
    const double nan = std::numeric_limits<double>::quiet_NaN();
    for (const double x : {nan, -nan, std::numeric_limits<double>::signaling_NaN()}) {
        CHECK(number_text(x) == "nan");
        CHECK(number_text(static_cast<float>(x)) == "nan");
    }
    const Random random{11, 0};
    for (std::uint64_t i = 0; i < 5000; ++i) {
        check_read_back(bit_cast<double>(random.bits(i)));
        check_read_back(bit_cast<float>(static_cast<std::uint32_t>(random.bits(i))));
    }
    for (const double x : {0.0, -0.0, 1e300, 5e-324, 1e21, 123456789012345680.0})
        check_read_back(x);
}

} // namespace

TEST_CASE("format: the shortest text that is read back") { check_all(); }

TEST_CASE("format: the same in a locale with a decimal comma and groups of digits") {
    test::GroupingLocale grouping;
    check_all();
    test::GermanLocale german;
    if (german.set()) check_all();
}
