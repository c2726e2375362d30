// SPDX-License-Identifier: Apache-2.0
/// rye/io/json.hpp: a small, strict JSON parser for headers inside binary files.
/// Rejects duplicate keys, depth above 64, numbers out of range, NaN, lone surrogates, trailing
/// text, and values that take more memory than allowed: a value of two bytes takes a hundred.
/// Numbers are parsed exactly, independent of the locale.
/// Source: RFC 8259.
#pragma once

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include <rye/core/error.hpp>
#include <rye/core/format.hpp>
#include <rye/core/memory.hpp>
#include <rye/core/parse.hpp>

namespace rye {

struct JsonValue;
struct JsonMember;
/// Elements in the order of the text.
using JsonArray = std::vector<JsonValue>;
/// Members in the order of the text.
using JsonObject = std::vector<JsonMember>;

/// JSON value.
struct JsonValue {
    /// Integers that fit 64 bits are kept exact.
    std::variant<std::nullptr_t, bool, std::int64_t, double, std::string, JsonArray, JsonObject>
        value;

    template <class T>
    const T* get() const {
        return std::get_if<T>(&value);
    }
    /// Returns the member of an object, or null.
    const JsonValue* find(std::string_view name) const;
};

/// Name and value of an object's member.
struct JsonMember {
    std::string name;
    JsonValue value;
};

inline const JsonValue* JsonValue::find(std::string_view name) const {
    if (const auto* object = get<JsonObject>())
        for (const JsonMember& member : *object)
            if (member.name == name) return &member.value;
    return nullptr;
}

namespace detail {

class JsonParser {
public:
    JsonParser(std::string_view text, const std::string& who, std::uint64_t memory)
        : text_(text), who_(who), memory_(memory) {}

    JsonValue parse() {
        JsonValue v = value(0);
        skip();
        if (at_ != text_.size()) fail("text after the end");
        return v;
    }

private:
    static constexpr int max_depth = 64;

    [[noreturn]] void fail(const std::string& message) const {
        throw Error(who_ + ": JSON at byte " + std::to_string(at_) + ": " + message);
    }
    /// Counts memory before it is allocated; lists grow to twice their size.
    void count(std::uint64_t bytes) {
        used_ += bytes;
        if (used_ > memory_)
            fail("its values to here would take " + std::to_string(used_) +
                 " bytes of memory, expected at most the limit of " + std::to_string(memory_));
    }
    char peek() const { return at_ < text_.size() ? text_[at_] : '\0'; }
    void skip() {
        while (peek() == ' ' || peek() == '\n' || peek() == '\r' || peek() == '\t') ++at_;
    }
    bool take(char c) {
        skip();
        if (peek() != c) return false;
        ++at_;
        return true;
    }
    void expect(char c) {
        if (!take(c)) fail(std::string("expected '") + c + "'");
    }
    bool take_word(std::string_view word) {
        if (text_.substr(at_, word.size()) != word) return false;
        at_ += word.size();
        return true;
    }

    JsonValue value(int depth) {
        if (depth > max_depth) fail("deeper than 64 levels");
        skip();
        switch (peek()) {
            case '{': return {object(depth)};
            case '[': return {array(depth)};
            case '"': return {string()};
            default: break;
        }
        if (take_word("true")) return {true};
        if (take_word("false")) return {false};
        if (take_word("null")) return {nullptr};
        return number();
    }
    JsonObject object(int depth) {
        JsonObject members;
        expect('{');
        if (take('}')) return members;
        do {
            skip();
            count(2 * sizeof(JsonMember));
            members.push_back({string(), {}});
            expect(':');
            members.back().value = value(depth + 1);
        } while (take(','));
        expect('}');
        require_distinct(members);
        return members;
    }
    void require_distinct(const JsonObject& members) const {
        std::vector<std::string_view> names;
        for (const JsonMember& member : members) names.push_back(member.name);
        std::sort(names.begin(), names.end());
        const auto twice = std::adjacent_find(names.begin(), names.end());
        if (twice != names.end()) fail("the key '" + std::string(*twice) + "' appears twice");
    }
    JsonArray array(int depth) {
        JsonArray items;
        expect('[');
        if (take(']')) return items;
        do {
            count(2 * sizeof(JsonValue));
            items.push_back(value(depth + 1));
        } while (take(','));
        expect(']');
        return items;
    }
    /// Parses -? (0 | [1-9][0-9]*) (.[0-9]+)? ([eE][+-]?[0-9]+)?
    JsonValue number() {
        const std::size_t start = at_;
        const auto digits = [&] {
            const std::size_t first = at_;
            while (peek() >= '0' && peek() <= '9') ++at_;
            if (at_ == first) fail("expected a value");
        };
        if (peek() == '-') ++at_;
        if (peek() == '0') ++at_;
        else digits();
        bool whole = true;
        if (peek() == '.') {
            whole = false;
            ++at_;
            digits();
        }
        if (peek() == 'e' || peek() == 'E') {
            whole = false;
            ++at_;
            if (peek() == '+' || peek() == '-') ++at_;
            digits();
        }
        const char* first = text_.data() + start;
        const char* last = text_.data() + at_;
        std::int64_t i = 0;
        if (whole && std::from_chars(first, last, i).ec == std::errc()) return {i};
        const std::optional<double> d = parse_double(text_.substr(start, at_ - start));
        if (!d || !std::isfinite(*d)) fail("a number is out of range");
        return {*d};
    }
    std::string string() {
        if (peek() != '"') fail("expected a string");
        ++at_;
        std::string out;
        for (;;) {
            if (at_ >= text_.size()) fail("a string does not end");
            const char c = text_[at_++];
            if (c == '"') {
                count(out.size());
                return out;
            }
            if (static_cast<unsigned char>(c) < 0x20) fail("a control character in a string");
            if (c == '\\') escape(out);
            else out += c;
        }
    }
    void escape(std::string& out) {
        static constexpr std::string_view from = "\"\\/bfnrt", to = "\"\\/\b\f\n\r\t";
        const char c = peek();
        ++at_;
        if (const std::size_t i = from.find(c); i != std::string_view::npos) {
            out += to[i];
            return;
        }
        if (c != 'u') fail("unknown escape");
        std::uint32_t code = hex4();
        if (code >= 0xDC00 && code < 0xE000) fail("lone surrogate");
        if (code >= 0xD800 && code < 0xDC00) {
            if (!take_word("\\u")) fail("lone surrogate");
            const std::uint32_t low = hex4();
            if (low < 0xDC00 || low >= 0xE000) fail("lone surrogate");
            code = 0x10000 + ((code - 0xD800) << 10U) + (low - 0xDC00);
        }
        append_utf8(out, code);
    }
    std::uint32_t hex4() {
        std::uint32_t code = 0;
        const std::string_view digits = text_.substr(std::min(at_, text_.size()), 4);
        const auto [end, status] =
            std::from_chars(digits.data(), digits.data() + digits.size(), code, 16);
        if (status != std::errc() || end != digits.data() + 4) fail("expected 4 hex digits");
        at_ += 4;
        return code;
    }
    static void append_utf8(std::string& out, std::uint32_t code) {
        const auto put = [&](std::uint32_t byte) { out += static_cast<char>(byte); };
        const auto tail = [&](unsigned shift) { put(0x80U | ((code >> shift) & 0x3FU)); };
        if (code < 0x80) return put(code);
        if (code < 0x800) {
            put(0xC0U | (code >> 6U));
        } else if (code < 0x10000) {
            put(0xE0U | (code >> 12U));
            tail(6);
        } else {
            put(0xF0U | (code >> 18U));
            tail(12);
            tail(6);
        }
        tail(0);
    }

    std::string_view text_;
    const std::string& who_;
    std::uint64_t memory_, used_ = 0;
    std::size_t at_ = 0;
};

} // namespace detail

/// Parses the whole text; errors begin with `who`. Throws an Error before its values take more
/// bytes than `memory`.
inline JsonValue parse_json(std::string_view text, const std::string& who,
                            std::uint64_t memory = default_memory / 8) {
    return detail::JsonParser(text, who, memory).parse();
}

namespace detail {

/// Returns the string quoted and escaped.
inline std::string json_string(std::string_view s) {
    static constexpr std::string_view hex = "0123456789abcdef";
    std::string out = "\"";
    for (const char c : s) {
        const auto u = static_cast<unsigned char>(c);
        if (c == '"' || c == '\\') (out += '\\') += c;
        else if (u < 0x20) ((out += "\\u00") += hex[u >> 4U]) += hex[u & 15U];
        else out += c;
    }
    return out + '"';
}

} // namespace detail

/// Returns the value as JSON on one line.
inline std::string json_text(const JsonValue& value) {
    const auto joined = [](const auto& items, const auto& text_of) {
        std::string out;
        for (const auto& item : items) (out += out.empty() ? "" : ",") += text_of(item);
        return out;
    };
    if (const auto* b = value.get<bool>()) return *b ? "true" : "false";
    if (const auto* i = value.get<std::int64_t>()) return number_text(*i);
    if (const auto* d = value.get<double>()) return number_text(*d);
    if (const auto* s = value.get<std::string>()) return detail::json_string(*s);
    if (const auto* a = value.get<JsonArray>()) return '[' + joined(*a, json_text) + ']';
    if (const auto* o = value.get<JsonObject>())
        return '{' +
               joined(*o,
                      [](const JsonMember& m) {
                          return detail::json_string(m.name) + ':' + json_text(m.value);
                      }) +
               '}';
    return "null";
}

namespace detail {

/// Throws an Error, which begins with `who`, for a text that is not UTF-8. parse_json takes any
/// bytes in strings.
inline void require_utf8(std::string_view text, const std::string& who) {
    const auto byte = [&](std::size_t i) {
        return i < text.size() ? static_cast<unsigned char>(text[i]) : 0U;
    };
    for (std::size_t at = 0; at < text.size();) {
        const unsigned first = byte(at), second = byte(at + 1);
        const std::size_t length = first < 0x80   ? 1
                                   : first < 0xC2 ? 0
                                   : first < 0xE0 ? 2
                                   : first < 0xF0 ? 3
                                   : first < 0xF5 ? 4
                                                  : 0;
        bool valid = length > 0;
        for (std::size_t k = 1; k < length; ++k) valid = valid && (byte(at + k) >> 6U) == 2;
        // Too long a form, a surrogate, beyond the last code.
        valid = valid && !(first == 0xE0 && second < 0xA0) && !(first == 0xED && second > 0x9F) &&
                !(first == 0xF0 && second < 0x90) && !(first == 0xF4 && second > 0x8F);
        require(valid, who, "its byte ", at, " begins no character of UTF-8");
        at += length;
    }
}

} // namespace detail

} // namespace rye
