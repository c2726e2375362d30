// SPDX-License-Identifier: Apache-2.0
/// rye/io/gltf_file.hpp: a glTF 2.0 file as JSON and buffers: .gltf, or GLB with a binary
/// chunk; buffers in that chunk, in data: URIs, or in files that the caller reads. Numbers of
/// accessors as columns. Lists of the file are checked where they are asked for.
/// Source: glTF 2.0 specification (Khronos, 2021), 3.6 and 4.4; RFC 4648 (base64).
#pragma once

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <functional>
#include <initializer_list>
#include <map>
#include <string>

#include <rye/io/bytes.hpp>
#include <rye/io/json.hpp>
#include <rye/core/memory.hpp>
#include <rye/math/linalg.hpp>

namespace rye::detail {

/// Function from the URI of a buffer, which is relative, without percent signs, and its size
/// [bytes] to its first bytes, so many; errors begin with `who`.
using GltfBuffer =
    std::function<Bytes(const std::string& uri, std::uint64_t size, const std::string& who)>;

/// Type of the numbers of an accessor: 5120 signed byte, 5121 byte, 5122 short, 5123 unsigned
/// short, 5126 float.
struct GltfType {
    std::int64_t component = 5126;
    bool normalized = false;
    bool operator==(const GltfType&) const = default;
};

/// Returns the bytes of base64; throws an Error for other characters or a length that is none.
inline Bytes base64_bytes(std::string_view text, const std::string& who) {
    constexpr std::string_view digits =
        "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    std::array<int, 256> value;
    value.fill(-1);
    for (std::size_t k = 0; k < digits.size(); ++k)
        value[static_cast<unsigned char>(digits[k])] = static_cast<int>(k);
    while (text.ends_with('=')) text.remove_suffix(1);
    require(text.size() % 4 != 1, who, "base64 of ", text.size(), " characters, which is none");
    Bytes out;
    out.reserve(text.size() / 4 * 3 + 3);
    std::uint32_t held = 0;
    int bits = 0;
    for (std::size_t at = 0; at < text.size(); ++at) {
        const int digit = value[static_cast<unsigned char>(text[at])];
        require(digit >= 0, who, "character ", at, " of the base64 is none of its digits");
        held = held << 6U | static_cast<std::uint32_t>(digit);
        bits += 6;
        if (bits < 8) continue;
        bits -= 8;
        append(out, static_cast<std::uint8_t>(held >> static_cast<unsigned>(bits)));
    }
    return out;
}

/// Returns a URI without percent signs; throws an Error unless it names a file relative to the
/// glTF.
inline std::string gltf_relative(std::string_view uri, const std::string& who) {
    std::string name;
    for (std::size_t at = 0; at < uri.size(); ++at) {
        int code = static_cast<unsigned char>(uri[at]);
        if (uri[at] == '%') {
            const std::string_view hex = uri.substr(at + 1, 2);
            const auto [end, status] =
                std::from_chars(hex.data(), hex.data() + hex.size(), code, 16);
            require(status == std::errc() && end == hex.data() + 2, who, "the URI ", uri,
                    " has a % without two hexadecimal digits");
            at += 2;
        }
        require(code >= 32, who, "the URI ", uri, " has a control character");
        name += static_cast<char>(code);
    }
    const std::size_t colon = name.find(':');
    require(!name.empty() && name[0] != '/' && name[0] != '\\' &&
                (colon == std::string::npos || colon > name.find('/')),
            who, "the URI ", uri, ", expected data: or a file relative to the glTF");
    return name;
}

/// A glTF file whose lists and buffers are asked for one by one.
class GltfFile {
  public:
    /// Parses the JSON of a .gltf or GLB; throws an Error for damage.
    GltfFile(ByteSpan file, const std::string& who, std::uint64_t memory, const GltfBuffer& outside)
        : who_(who),
          memory_(memory),
          outside_(outside) {
        ByteSpan text = file;
        if (as_text(file.first(std::min<std::size_t>(file.size(), 4))) == "glTF") {
            const auto version = word(file, 4, "the GLB header");
            require(version == 2, who, "got GLB version ", version, ", expected 2");
            const auto length = word(file, 8, "the GLB header");
            require(length <= file.size(), who, "truncated: got ", file.size(),
                    " bytes, expected the ", length, " of its header");
            text = chunk(file.first(length), 12, 0x4E4F534A, "its JSON chunk");
            const std::size_t next = 20 + text.size();
            if (next < length) chunk_ = chunk(file.first(length), next, 0x004E4942, "its chunk");
        }
        root_ = parse_json(as_text(text), who, memory / 8);
        const JsonValue* asset = root_.find("asset");
        const JsonValue* version = asset ? asset->find("version") : nullptr;
        const auto* number = version ? version->get<std::string>() : nullptr;
        require(number != nullptr && number->starts_with("2."), who, "asset.version is ",
                version ? json_text(*version) : "missing", ", expected \"2.0\"");
    }

    const JsonValue& root() const { return root_; }
    const std::string& who() const { return who_; }
    std::uint64_t memory() const { return memory_; }

    /// Returns the number of items of a list at the top.
    std::size_t count(const char* list) const {
        const JsonValue* items = root_.find(list);
        const JsonArray* array = items ? items->get<JsonArray>() : nullptr;
        return array ? array->size() : 0;
    }
    /// Returns an item; throws an Error beyond the list.
    const JsonValue& item(const char* list, std::uint64_t index, const std::string& from) const {
        require(index < count(list), who_, from, ": ", list, "[", index, "], expected 0 to below ",
                count(list));
        return (*root_.find(list)->get<JsonArray>())[static_cast<std::size_t>(index)];
    }
    /// Returns a whole number of an object that is not negative, or the default; throws an Error
    /// for another value, or none without a default (-1).
    std::uint64_t whole(const JsonValue& object, const char* name, const std::string& where,
                        std::int64_t otherwise = -1) const {
        const JsonValue* value = object.find(name);
        std::int64_t number = otherwise;
        if (value) {
            const auto* exact = value->get<std::int64_t>();
            number = exact ? *exact : -1;
        }
        require(number >= 0, who_, where, ".", name, " is ",
                value ? json_text(*value).substr(0, 60) : "missing",
                ", expected a whole number of at least 0");
        return static_cast<std::uint64_t>(number);
    }

    /// Returns an accessor's numbers, a column an element of 1, 3 or 4; `count` is the expected
    /// number of elements, -1 any. Throws an Error for another type than those, a view beyond its
    /// buffer, and numbers that are not finite.
    template <Real T>
    Columns<T> columns(std::uint64_t accessor, Index rows, std::int64_t count,
                       std::initializer_list<GltfType> types, const std::string& from) {
        const JsonValue& a = item("accessors", accessor, from);
        const std::string where = from + ": accessors[" + std::to_string(accessor) + "]";
        require(!a.find("sparse"), who_, where, ".sparse is not supported");
        const std::string expected = rows == 1 ? "SCALAR" : rows == 3 ? "VEC3" : "VEC4";
        const JsonValue* kind = a.find("type");
        const auto* name = kind ? kind->get<std::string>() : nullptr;
        require(name && *name == expected, who_, where, ".type is ",
                kind ? json_text(*kind) : "missing", ", expected ", expected);
        GltfType type{static_cast<std::int64_t>(whole(a, "componentType", where)), false};
        if (const JsonValue* normalized = a.find("normalized"))
            type.normalized = normalized->get<bool>() && *normalized->get<bool>();
        require(std::find(types.begin(), types.end(), type) != types.end(), who_, where,
                ".componentType is ", type.component, type.normalized ? ", normalized" : "",
                ", which the attribute may not have");
        const std::uint64_t n = whole(a, "count", where);
        require(n > 0 && (count < 0 || n == static_cast<std::uint64_t>(count)), who_, where,
                ".count is ", n, ", expected ", count < 0 ? "at least 1" : std::to_string(count));
        const std::size_t size = type.component < 5122 ? 1 : type.component < 5124 ? 2 : 4;
        const std::size_t element = size * static_cast<std::size_t>(rows);
        const JsonValue& view = item("bufferViews", whole(a, "bufferView", where), where);
        const std::string seen = where + ": its bufferView";
        const std::uint64_t stride =
            whole(view, "byteStride", seen, static_cast<std::int64_t>(element));
        require(stride >= element && stride <= 252, who_, seen, ".byteStride is ", stride,
                ", expected ", element, " to 252");
        const ByteSpan data = slice(
            slice(buffer(whole(view, "buffer", seen), seen), whole(view, "byteOffset", seen, 0),
                  whole(view, "byteLength", seen), who_ + ": " + seen, "its data"),
            whole(a, "byteOffset", where, 0),
            saturated_sum(saturated_product(n - 1, stride), element), who_ + ": " + where,
            "its data");
        Columns<T> out(rows, static_cast<Index>(n));
        for (std::size_t i = 0; i < n; ++i)
            for (std::size_t k = 0; k < static_cast<std::size_t>(rows); ++k)
                out(static_cast<Index>(k), static_cast<Index>(i)) =
                    number<T>(data.data() + i * stride + k * size, type);
        for (Index i = 0; i < out.cols(); ++i)
            for (Index k = 0; k < rows; ++k)
                if (!std::isfinite(out(k, i)))
                    throw Error(who_ + ": " + from + ": component " + std::to_string(k) +
                                " of Gaussian " + std::to_string(i) + " is " +
                                number_text(out(k, i)) + ", expected a finite number");
        return out;
    }

  private:
    std::uint32_t word(ByteSpan file, std::uint64_t at, const char* what) const {
        return read_at<std::uint32_t>(file, at, who_, what);
    }
    ByteSpan chunk(ByteSpan file, std::uint64_t at, std::uint32_t type, const char* what) const {
        const std::uint32_t length = word(file, at, what), got = word(file, at + 4, what);
        // Of chunks after the first only the binary one has a meaning.
        require(got == type || at > 12, who_, what, " has the type ", got, ", expected ", type);
        const ByteSpan data = slice(file, at + 8, length, who_, what);
        return got == type ? data : ByteSpan();
    }
    template <Real T>
    static T number(const std::byte* at, GltfType type) {
        const auto as = [&](auto x, double unit) {
            std::memcpy(&x, at, sizeof x);
            const T value = static_cast<T>(x);
            return type.normalized ? std::max(value / static_cast<T>(unit), T(-1)) : value;
        };
        switch (type.component) {
            case 5120:
                return as(std::int8_t(), 127);
            case 5121:
                return as(std::uint8_t(), 255);
            case 5122:
                return as(std::int16_t(), 32767);
            case 5123:
                return as(std::uint16_t(), 65535);
            default:
                return as(float(), 1);
        }
    }
    /// Returns a buffer, read or decoded once.
    ByteSpan buffer(std::uint64_t index, const std::string& from) {
        if (const auto known = buffers_.find(index); known != buffers_.end()) return known->second;
        const JsonValue& b = item("buffers", index, from);
        const std::string where = "buffers[" + std::to_string(index) + "]";
        const std::uint64_t size = whole(b, "byteLength", where);
        const JsonValue* value = b.find("uri");
        if (!value && index == 0)
            return slice(chunk_, 0, size, who_ + ": " + where, "the binary chunk");
        const auto* uri = value ? value->get<std::string>() : nullptr;
        require(uri != nullptr, who_, where, ".uri is missing");
        held_ = saturated_sum(held_, size);
        require_memory(held_, memory_, who_, "its buffers");
        Bytes bytes;
        if (uri->starts_with("data:")) {
            constexpr std::string_view mark = ";base64,";
            const std::size_t begin = uri->find(mark);
            require(begin < 100, who_, where, ".uri is data: without ;base64,");
            bytes = base64_bytes(std::string_view(*uri).substr(begin + mark.size()),
                                 who_ + ": " + where);
        } else {
            require(static_cast<bool>(outside_), who_, where, ".uri is ", *uri,
                    ", a file of its own, expected data:");
            bytes = outside_(gltf_relative(*uri, who_ + ": " + where), size, who_ + ": " + where);
        }
        slice(bytes, 0, size, who_ + ": " + where, "byteLength");
        return buffers_.emplace(index, std::move(bytes)).first->second;
    }

    std::string who_;
    std::uint64_t memory_, held_ = 0; ///< limit, and bytes of the buffers so far
    GltfBuffer outside_;
    ByteSpan chunk_;
    JsonValue root_;
    std::map<std::uint64_t, Bytes> buffers_;
};

} // namespace rye::detail
