// SPDX-License-Identifier: Apache-2.0
#include <rye/io/json.hpp>

#include <clocale>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <limits>
#include <string>

#include <doctest/doctest.h>

#include <rye/core/random.hpp>

#include "../support/hostile.hpp"

using namespace rye;

namespace {

JsonValue parse(const std::string& text) { return parse_json(text, "x.json"); }
double number(const std::string& text) { return *parse(text).get<double>(); }

} // namespace

TEST_CASE("json: every kind of value, members in their order") {
    const JsonValue v =
        parse(R"( {"b" : [1, -2.5, true, false, null, "q\"\\\n"], "a":{"deep":[[]],"none":{}}} )");
    REQUIRE(v.find("b"));
    const JsonArray& b = *v.find("b")->get<JsonArray>();
    REQUIRE(b.size() == 6);
    CHECK(*b[0].get<std::int64_t>() == 1);
    CHECK(*b[1].get<double>() == -2.5);
    CHECK(*b[2].get<bool>());
    CHECK(!*b[3].get<bool>());
    CHECK(b[4].get<std::nullptr_t>());
    CHECK(*b[5].get<std::string>() == "q\"\\\n");
    CHECK(v.find("c") == nullptr);
    CHECK(b[0].find("c") == nullptr);
    CHECK(v.get<JsonObject>()->at(1).name == "a");
    CHECK(v.find("a")->find("deep")->get<JsonArray>()->at(0).get<JsonArray>()->empty());
}

TEST_CASE("json: numbers come back exactly, integers as integers") {
    const Random random{7};
    for (std::uint64_t i = 0; i < 2000; ++i) {
        double x = 0;
        const std::uint64_t bits = random.bits(i);
        std::memcpy(&x, &bits, 8);
        if (!std::isfinite(x)) continue;
        char text[64];
        std::snprintf(text, sizeof text, "%.17e", x);
        CHECK(number(text) == x);
    }
    for (const std::int64_t i : {std::numeric_limits<std::int64_t>::max(),
                                 std::numeric_limits<std::int64_t>::min(), std::int64_t(0)})
        CHECK(*parse(std::to_string(i)).get<std::int64_t>() == i);
    CHECK(number("9223372036854775808") == 9223372036854775808.0); // one more than an int64
}

TEST_CASE("json: a locale with decimal commas changes nothing") {
    const std::string before = std::setlocale(LC_ALL, nullptr);
    // Absent on small systems; the case above covers these.
    std::setlocale(LC_ALL, "de_DE.UTF-8");
    CHECK(number("1.5") == 1.5);
    std::setlocale(LC_ALL, before.c_str());
}

TEST_CASE("json: escapes are UTF-8") {
    CHECK(*parse(R"("\u00e9\u20AC\ud83d\ude00\/\b")").get<std::string>() ==
          "\xC3\xA9\xE2\x82\xAC\xF0\x9F\x98\x80/\b");
    const std::string wild = "\x01 \"\\ \xC3\xA9";
    CHECK(detail::json_string("\x01\"") == R"("\u0001\"")");
    CHECK(*parse(detail::json_string(wild)).get<std::string>() == wild);
}

TEST_CASE("json: what is not JSON is refused with the place") {
    for (const char* text : {"",
                             " ",
                             "{",
                             "[",
                             "[1",
                             "[1,",
                             "[1,]",
                             "{\"a\"}",
                             "{\"a\":}",
                             "{\"a\":1,}",
                             "{a:1}",
                             "01",
                             "-",
                             "1.",
                             ".5",
                             "1e",
                             "+1",
                             "NaN",
                             "Infinity",
                             "-Infinity",
                             "nul",
                             "tru",
                             "'a'",
                             "\"a",
                             "\"\\x\"",
                             "\"\\u12\"",
                             "\"\\ud800\"",
                             "\"\\ud800\\u0041\"",
                             "\"\\udc00\"",
                             "\"\n\"",
                             "[1]]",
                             "1 2",
                             "1e999",
                             "-1e999",
                             "{\"a\":1 \"b\":2}",
                             "/**/1"}) {
        INFO("text: ", text);
        CHECK_FAULT(parse(text), "x.json: JSON at byte");
    }
    CHECK_FAULT(parse(R"({"a":1,"b":2,"a":3})"), "the key 'a' appears twice");
}

TEST_CASE("json: depth is bounded") {
    const auto nested = [](std::size_t n) { return std::string(n, '[') + std::string(n, ']'); };
    CHECK_NOTHROW(parse(nested(65)));
    CHECK_FAULT(parse(nested(66)), "deeper than 64");
    CHECK_FAULT(parse(std::string(1000000, '[')), "deeper than 64");
}

TEST_CASE("json: a value as text on one line") {
    const std::string text = R"({"a":[1,-0.5,true,false,null],"b\"":{},"c":"d"})";
    CHECK(json_text(parse_json(text, "a")) == text);
    CHECK(json_text(parse_json(" [ 64 , 64.0 ] ", "a")) == "[64,64]");
}

TEST_CASE("json: texts that are not UTF-8") {
    for (const char* good : {"", "a", "\xC3\xA4", "\xE2\x82\xAC", "\xF0\x9F\x99\x82",
                             "\xED\x9F\xBF", "\xF4\x8F\xBF\xBF"})
        CHECK_NOTHROW(detail::require_utf8(good, "a"));
    for (const char* bad : {"\x80", "\xC0\x80", "\xC3", "\xE0\x80\x80", "\xED\xA0\x80",
                            "\xF0\x80\x80\x80", "\xF4\x90\x80\x80", "\xF5\x80\x80\x80",
                            "\xE2\x82"})
        CHECK_FAULT(detail::require_utf8(std::string("ab") + bad, "a.json"),
                    "a.json: its byte 2 begins");
}
