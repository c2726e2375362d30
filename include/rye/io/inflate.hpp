// SPDX-License-Identifier: Apache-2.0
/// rye/io/inflate.hpp: decompression of deflate.
/// The caller gives the size of the result; a zip bomb is an Error, not an allocation.
/// Source: RFC 1951 (deflate); decoding by canonical counts as in zlib's puff.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <utility>

#include <rye/io/bytes.hpp>
#include <rye/core/checksum.hpp>
#include <rye/core/error.hpp>

namespace rye {

namespace detail {

/// Canonical Huffman code: number of codes of each length, and their symbols in order.
struct HuffmanCode {
    std::array<std::uint16_t, 16> count{};
    std::array<std::uint16_t, 288> symbol{};

    /// Builds the code; returns false if the lengths are over-subscribed or incomplete.
    bool build(const std::uint8_t* lengths, int n) {
        count.fill(0);
        for (int i = 0; i < n; ++i) ++count[lengths[i]];
        int left = 1;
        for (std::size_t l = 1; l < 16; ++l) {
            left = 2 * left - count[l];
            if (left < 0) return false;
        }
        std::array<std::uint16_t, 16> next{};
        for (std::size_t l = 1; l < 15; ++l)
            next[l + 1] = static_cast<std::uint16_t>(next[l] + count[l]);
        for (int i = 0; i < n; ++i)
            if (lengths[i]) symbol[next[lengths[i]]++] = static_cast<std::uint16_t>(i);
        // Incomplete codes are legal only as a single code of one bit (RFC 1951, 3.2.7).
        return left == 0 || n - count[0] <= 1;
    }
};

/// Expected length of a stream: exactly the requested size, or at least that.
enum class Inflate { whole, beginning };

class Inflater {
public:
    Inflater(ByteSpan in, std::size_t size, Inflate what, const std::string& who)
        : in_(in), size_(size), what_(what), who_(who) {
        out_.reserve(size);
    }

    Bytes run() {
        bool last = false;
        while (!last && !enough()) {
            last = bits(1) != 0;
            switch (bits(2)) {
                case 0: stored(); break;
                case 1: fixed(); break;
                case 2: dynamic(); break;
                default: fail("unknown block type");
            }
        }
        if (out_.size() != size_)
            fail("got " + std::to_string(out_.size()) + " bytes, expected " +
                 std::to_string(size_));
        return std::move(out_);
    }

private:
    [[noreturn]] void fail(const std::string& message) const {
        throw Error(who_ + ": deflate: " + message);
    }
    std::uint32_t bits(int n) {
        while (held_ < n) {
            if (at_ == in_.size()) fail("the data end too early");
            hold_ |= static_cast<std::uint32_t>(in_[at_++]) << held_;
            held_ += 8;
        }
        const std::uint32_t value = hold_ & ((1U << n) - 1U);
        hold_ >>= n;
        held_ -= n;
        return value;
    }
    bool enough() const { return what_ == Inflate::beginning && out_.size() == size_; }
    void put(std::byte b) {
        if (enough()) return;
        if (out_.size() == size_)
            fail("more than the declared " + std::to_string(size_) + " bytes");
        out_.push_back(b);
    }
    int decode(const HuffmanCode& code) {
        int value = 0, first = 0, index = 0;
        for (std::size_t l = 1; l < 16; ++l) {
            value |= static_cast<int>(bits(1));
            const int n = code.count[l];
            if (value - n < first)
                return code.symbol[static_cast<std::size_t>(index + value - first)];
            index += n;
            first = (first + n) << 1;
            value <<= 1;
        }
        fail("a code is not in the table");
    }
    void stored() {
        hold_ = 0;  // the rest of the byte is padding
        held_ = 0;
        const auto length = read_at<std::uint16_t>(in_, at_, who_, "a stored block");
        const auto check = read_at<std::uint16_t>(in_, at_ + 2, who_, "a stored block");
        if (length != static_cast<std::uint16_t>(~check))
            fail("a stored block's length is damaged");
        for (const std::byte b : slice(in_, at_ + 4, length, who_, "a stored block")) put(b);
        at_ += 4 + std::size_t(length);
    }
    void compressed(const HuffmanCode& lengths, const HuffmanCode& distances) {
        static constexpr std::array<int, 29> length_base{
            3,  4,  5,  6,  7,  8,  9,  10, 11,  13,  15,  17,  19,  23, 27,
            31, 35, 43, 51, 59, 67, 83, 99, 115, 131, 163, 195, 227, 258};
        static constexpr std::array<int, 29> length_bits{0, 0, 0, 0, 0, 0, 0, 0, 1, 1,
                                                         1, 1, 2, 2, 2, 2, 3, 3, 3, 3,
                                                         4, 4, 4, 4, 5, 5, 5, 5, 0};
        static constexpr std::array<int, 30> distance_base{
            1,   2,   3,   4,   5,   7,    9,    13,   17,   25,   33,   49,   65,    97,    129,
            193, 257, 385, 513, 769, 1025, 1537, 2049, 3073, 4097, 6145, 8193, 12289, 16385, 24577};
        while (!enough()) {
            const int symbol = decode(lengths);
            if (symbol < 256) {
                put(static_cast<std::byte>(symbol));
                continue;
            }
            if (symbol == 256) return;
            const auto l = static_cast<std::size_t>(symbol - 257);
            if (l >= length_base.size()) fail("unknown length symbol");
            const int length = length_base[l] + static_cast<int>(bits(length_bits[l]));
            const auto d = static_cast<std::size_t>(decode(distances));
            if (d >= distance_base.size()) fail("unknown distance symbol");
            const int extra = d < 4 ? 0 : static_cast<int>(d) / 2 - 1;
            const auto distance = static_cast<std::size_t>(distance_base[d]) + bits(extra);
            if (distance > out_.size()) fail("a copy starts before the beginning");
            for (int i = 0; i < length; ++i) put(out_[out_.size() - distance]);
        }
    }
    void fixed() {
        std::array<std::uint8_t, 288> length{};
        for (std::size_t i = 0; i < 288; ++i)
            length[i] = i < 144 ? 8 : i < 256 ? 9 : i < 280 ? 7 : 8;
        std::array<std::uint8_t, 32> distance{};
        distance.fill(5);
        HuffmanCode lengths, distances;
        lengths.build(length.data(), 288);
        distances.build(distance.data(), 32);
        compressed(lengths, distances);
    }
    void dynamic() {
        static constexpr std::array<std::size_t, 19> order{16, 17, 18, 0, 8,  7, 9,  6, 10, 5,
                                                           11, 4,  12, 3, 13, 2, 14, 1, 15};
        const std::size_t n_length = bits(5) + 257, n_distance = bits(5) + 1, n_code = bits(4) + 4;
        if (n_length > 286) fail("too many length codes");
        std::array<std::uint8_t, 320> length{};
        for (std::size_t i = 0; i < n_code; ++i)
            length[order[i]] = static_cast<std::uint8_t>(bits(3));
        HuffmanCode code, lengths, distances;
        if (!code.build(length.data(), 19)) fail("the code of code lengths is damaged");
        length.fill(0);
        for (std::size_t i = 0; i < n_length + n_distance;) {
            const int symbol = decode(code);
            if (symbol < 16) {
                length[i++] = static_cast<std::uint8_t>(symbol);
                continue;
            }
            if (symbol == 16 && i == 0) fail("a repeat without a previous length");
            const std::uint8_t value = symbol == 16 ? length[i - 1] : std::uint8_t(0);
            const std::size_t repeat = symbol == 16   ? 3 + bits(2)
                                       : symbol == 17 ? 3 + bits(3)
                                                      : 11 + bits(7);
            if (i + repeat > n_length + n_distance) fail("a repeat exceeds the last code");
            for (std::size_t k = 0; k < repeat; ++k) length[i++] = value;
        }
        if (length[256] == 0) fail("a block has no end code");
        if (!lengths.build(length.data(), static_cast<int>(n_length)) ||
            !distances.build(length.data() + n_length, static_cast<int>(n_distance)))
            fail("the code of a block is damaged");
        compressed(lengths, distances);
    }

    ByteSpan in_;
    std::size_t size_;
    Inflate what_;
    const std::string& who_;
    Bytes out_;
    std::size_t at_ = 0;
    std::uint32_t hold_ = 0;
    int held_ = 0;
};

} // namespace detail

/// Largest ratio of deflate; a header that states more is invalid.
inline constexpr std::uint64_t max_deflate_ratio = 1032;

namespace detail {

/// Throws an Error if no deflate stream of this length can hold data of the declared size.
inline void require_inflatable(ByteSpan compressed, std::uint64_t size, const std::string& who) {
    require(size <= compressed.size() * max_deflate_ratio + 64, who, compressed.size(),
            " compressed bytes cannot hold the declared ", size);
}

} // namespace detail

/// Decompresses a raw deflate stream to exactly `size` bytes; throws an Error otherwise.
inline Bytes inflate(ByteSpan compressed, std::uint64_t size, const std::string& who) {
    detail::require_inflatable(compressed, size, who);
    return detail::Inflater(compressed, static_cast<std::size_t>(size), detail::Inflate::whole, who)
        .run();
}

namespace detail {

/// Returns the first `size` bytes of a raw deflate stream; throws an Error if it has fewer.
inline Bytes inflate_beginning(ByteSpan compressed, std::size_t size, const std::string& who) {
    return detail::Inflater(compressed, size, detail::Inflate::beginning, who).run();
}

} // namespace detail

} // namespace rye
