// SPDX-License-Identifier: Apache-2.0
/// rye/io/npy.hpp: NumPy's .npy arrays, versions 1 to 3, numbers only.
/// Whatever the file's byte order and layout, an NpyArray is little-endian in C order, so an array
/// of shape (N, D) is a Columns of D x N without reordering.
/// Source: numpy.lib.format.
#pragma once

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <concepts>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <limits>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include <rye/io/atomic_file.hpp>
#include <rye/io/bytes.hpp>
#include <rye/core/columns.hpp>
#include <rye/core/error.hpp>

namespace rye {

/// Returns a shape as NumPy prints it, such as "(68, 3)".
inline std::string shape_text(const std::vector<Index>& shape) {
    std::string text = "(";
    for (std::size_t i = 0; i < shape.size(); ++i)
        text += (i ? ", " : "") + std::to_string(shape[i]);
    return text + (shape.size() == 1 ? ",)" : ")");
}

/// Array of numbers, little-endian in C order (last index fastest).
struct NpyArray {
    char kind = 'f';           ///< b bool, i signed, u unsigned, f float
    int item_size = 8;         ///< [bytes]
    std::vector<Index> shape;  ///< empty for a single number
    Bytes bytes;

    Index size() const {
        Index n = 1;
        for (const Index d : shape) n *= d;
        return n;
    }
    std::string type() const { return std::string(1, kind) + std::to_string(item_size); }

    /// Returns the converted numbers; throws an Error, with `who` first, for one that does not
    /// fit T.
    template <class T>
    std::vector<T> values(const std::string& who) const;
};

/// Largest header accepted; usual ones have about 100 bytes.
inline constexpr std::uint64_t max_npy_header = 65536;

namespace detail {

struct NpyHeader {
    bool swapped = false;
    bool fortran = false;
    NpyArray array;  // without data
};

/// Parses the dict {'descr': '<f4', 'fortran_order': False, 'shape': (68, 3), }.
class NpyHeaderParser {
public:
    NpyHeaderParser(std::string_view text, const std::string& who) : text_(text), who_(who) {}

    NpyHeader parse() {
        bool descr = false, order = false, shape = false;
        expect('{');
        while (!take('}')) {
            const std::string key = quoted();
            expect(':');
            if (key == "descr" && !descr) descr = parse_type();
            else if (key == "fortran_order" && !order) order = parse_order();
            else if (key == "shape" && !shape) shape = parse_shape();
            else fail("the key '" + key + "' is unknown or repeated");
            if (!take(',')) {
                expect('}');
                break;
            }
        }
        skip();
        if (at_ != text_.size()) fail("text follows the header's dict");
        if (!descr || !order || !shape) fail("one of descr, fortran_order, shape is missing");
        return header_;
    }

private:
    [[noreturn]] void fail(const std::string& message) const {
        throw Error(who_ + ": npy header: " + message);
    }
    void skip() {
        while (at_ < text_.size() && (text_[at_] == ' ' || text_[at_] == '\n')) ++at_;
    }
    bool take(char c) {
        skip();
        if (at_ >= text_.size() || text_[at_] != c) return false;
        ++at_;
        return true;
    }
    void expect(char c) {
        if (!take(c)) fail("byte " + std::to_string(at_) + " is not the expected '" + c + "'");
    }
    bool take_word(std::string_view word) {
        skip();
        if (text_.substr(at_, word.size()) != word) return false;
        at_ += word.size();
        return true;
    }
    std::string quoted() {
        skip();
        const char quote = at_ < text_.size() ? text_[at_] : ' ';
        if (quote != '\'' && quote != '"') fail("expected a string, byte " + std::to_string(at_));
        const std::size_t end = text_.find(quote, at_ + 1);
        if (end == std::string_view::npos) fail("a string does not end");
        std::string word(text_.substr(at_ + 1, end - at_ - 1));
        at_ = end + 1;
        return word;
    }
    bool parse_type() {
        const std::string type = take('[') ? "a record" : quoted();
        static constexpr std::array known{"b1", "i1", "i2", "i4", "i8", "u1",
                                          "u2", "u4", "u8", "f4", "f8"};
        const std::string_view item = type.empty() ? "" : std::string_view(type).substr(1);
        const bool order = !type.empty() && std::string_view("<>=|").find(type[0]) < 4;
        if (!order || std::find(known.begin(), known.end(), item) == known.end())
            fail("got dtype '" + type + "', expected bool, integer, float32 or float64");
        header_.swapped = type[0] == '>';
        header_.array.kind = item[0];
        header_.array.item_size = item[1] - '0';
        return true;
    }
    bool parse_order() {
        if (take_word("True")) header_.fortran = true;
        else if (!take_word("False")) fail("fortran_order is neither True nor False");
        return true;
    }
    bool parse_shape() {
        expect('(');
        while (!take(')')) {
            skip();
            Index extent = -1;
            const char* end = text_.data() + text_.size();
            const auto [next, status] = std::from_chars(text_.data() + at_, end, extent);
            if (status != std::errc() || extent < 0) fail("an extent is not a count");
            at_ = static_cast<std::size_t>(next - text_.data());
            if (header_.array.shape.size() == 8) fail("more than 8 extents");
            header_.array.shape.push_back(extent);
            if (!take(',')) {
                expect(')');
                break;
            }
        }
        return true;
    }

    std::string_view text_;
    const std::string& who_;
    std::size_t at_ = 0;
    NpyHeader header_;
};

/// Returns data reordered from first index fastest to last index fastest.
inline Bytes c_order(ByteSpan data, const std::vector<Index>& shape, std::size_t item) {
    Bytes out(data.size());
    std::vector<Index> index(shape.size(), 0);
    for (std::size_t to = 0; to < data.size(); to += item) {
        std::size_t from = 0;
        for (std::size_t d = shape.size(); d-- > 0;)
            from = from * static_cast<std::size_t>(shape[d]) + static_cast<std::size_t>(index[d]);
        std::memcpy(out.data() + to, data.data() + from * item, item);
        for (std::size_t d = shape.size(); d-- > 0;) {
            if (++index[d] < shape[d]) break;
            index[d] = 0;
        }
    }
    return out;
}

} // namespace detail

/// Parses the bytes of a .npy file; errors begin with `who`.
inline NpyArray parse_npy(ByteSpan bytes, const std::string& who) {
    require(as_text(slice(bytes, 0, 8, who, "the npy magic")).substr(0, 6) == "\x93NUMPY", who,
            "not an npy array: it does not begin with \\x93NUMPY");
    const int version = static_cast<int>(bytes[6]);
    require(version >= 1 && version <= 3, who, "got npy version ", version, ", expected 1, 2 or 3");
    const std::uint64_t start = version == 1 ? 10 : 12;
    const std::uint64_t length = version == 1
                                     ? read_at<std::uint16_t>(bytes, 8, who, "the header length")
                                     : read_at<std::uint32_t>(bytes, 8, who, "the header length");
    require(length <= max_npy_header, who, "got an npy header of ", length,
            " bytes, expected at most ", max_npy_header);
    detail::NpyHeader header =
        detail::NpyHeaderParser(as_text(slice(bytes, start, length, who, "the npy header")), who)
            .parse();
    NpyArray& array = header.array;
    const auto item = static_cast<std::size_t>(array.item_size);
    const std::uint64_t size = checked_size(array.shape, item, who);
    const ByteSpan data = bytes.subspan(static_cast<std::size_t>(start + length));
    require(
        data.size() == size, who, "shape ", [&] { return shape_text(array.shape); }, " of ",
        array.type(), " needs ", size, " bytes, got ", data.size());
    array.bytes = header.fortran ? detail::c_order(data, array.shape, item)
                                 : Bytes(data.begin(), data.end());
    if (header.swapped)
        for (auto at = array.bytes.begin(); at != array.bytes.end(); at += array.item_size)
            std::reverse(at, at + array.item_size);
    return array;
}

/// Reads an npy file. Throws an Error as parse_npy does, with the path.
inline NpyArray read_npy(const std::filesystem::path& path) {
    return parse_npy(read_file(path), path.string());
}

template <class T>
std::vector<T> NpyArray::values(const std::string& who) const {
    std::vector<T> out(static_cast<std::size_t>(size()));
    const auto copy_from = [&]<class S>(S) {
        for (std::size_t i = 0; i < out.size(); ++i) {
            S value;
            std::memcpy(&value, bytes.data() + i * sizeof(S), sizeof(S));
            if constexpr (std::integral<T>) {
                bool fits = true;
                if constexpr (std::floating_point<S>)
                    fits = std::abs(value) < S(9e15) && std::trunc(value) == value &&
                           (std::is_signed_v<T> || value >= S(0)) &&
                           static_cast<S>(static_cast<T>(std::int64_t(value))) == value;
                else
                    fits = std::in_range<T>(value);
                if (!fits)
                    throw Error(who + ": number " + std::to_string(i) + " does not fit the type");
            }
            if constexpr (std::floating_point<T> && std::floating_point<S>)
                if (std::isfinite(value) && std::abs(value) > std::numeric_limits<T>::max())
                    throw Error(who + ": number " + std::to_string(i) + " does not fit the type");
            out[i] = static_cast<T>(value);
        }
    };
    const std::string t = type();
    if (t == "f4") copy_from(float());
    else if (t == "f8") copy_from(double());
    else if (t == "i8") copy_from(std::int64_t());
    else if (t == "i4") copy_from(std::int32_t());
    else if (t == "i2") copy_from(std::int16_t());
    else if (t == "i1") copy_from(std::int8_t());
    else if (t == "u8") copy_from(std::uint64_t());
    else if (t == "u4") copy_from(std::uint32_t());
    else if (t == "u2") copy_from(std::uint16_t());
    else copy_from(std::uint8_t());  // u1, b1
    return out;
}

/// Returns an array of the given numbers.
template <class T>
    requires std::is_arithmetic_v<T>
NpyArray npy_array(std::vector<Index> shape, std::span<const T> values) {
    NpyArray array;
    array.kind = std::is_same_v<T, bool> ? 'b' : std::floating_point<T> ? 'f'
                                             : std::is_signed_v<T>      ? 'i'
                                                                        : 'u';
    array.item_size = static_cast<int>(sizeof(T));
    array.shape = std::move(shape);
    RYE_ASSERT(array.size() == static_cast<Index>(values.size()),
               "npy_array: the shape has another size than values");
    const auto bytes = std::as_bytes(values);
    array.bytes.assign(bytes.begin(), bytes.end());
    return array;
}

/// Returns an array of shape (N, D) with D x N columns.
template <class T>
NpyArray npy_array(const Columns<T>& columns) {
    return npy_array<T>({columns.cols(), columns.rows()},
                        {columns.data(), static_cast<std::size_t>(columns.size())});
}

/// Returns the bytes of a .npy file, version 1, data at a multiple of 64 bytes as NumPy writes it.
inline Bytes npy_bytes(const NpyArray& array) {
    std::string header = std::string("{'descr': '") + (array.item_size == 1 ? '|' : '<') +
                         array.type() + "', 'fortran_order': False, 'shape': " +
                         shape_text(array.shape) + ", }";
    header.append(63 - (10 + header.size()) % 64, ' ');
    header += '\n';
    Bytes out;
    append(out, as_bytes(std::string_view("\x93NUMPY\x01\x00", 8)));
    append(out, static_cast<std::uint16_t>(header.size()));
    append(out, as_bytes(header));
    append(out, array.bytes);
    return out;
}

/// Replaces an npy file.
inline void write_npy(const std::filesystem::path& path, const NpyArray& array) {
    write_atomic(path, npy_bytes(array));
}

} // namespace rye
