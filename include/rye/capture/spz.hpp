// SPDX-License-Identifier: Apache-2.0
/// rye/capture/spz.hpp: the SPZ file, a gzip file of about 20 bytes per Gaussian: reads versions 2
/// and 3, writes version 3. Stored axes are x right, y up, z toward the viewer; clouds have those
/// of a PLY, so reading and writing rotate by half a turn about x. The many writers that do not
/// rotate give files that are read upside down.
/// After a header of 16 bytes come the arrays: positions as 24-bit fixed point with 12 fractional
/// bits, opacity 0..255, colour of band 0 as 0.15 f_dc 255 + 127.5, log scale as 16 (s + 10),
/// quaternions, harmonics as 128 + 128 c in steps of 8 in band 1 and of 16 above.
/// Largest differences after writing and reading: position 1/8192 [world units] (more where a cloud
/// reaches beyond 2048 units), opacity 0.5/255, f_dc 0.0131 within +-3.33, log scale 1/32 within
/// -10..5.94, rotation 0.2 degrees, harmonics 1/32 and 1/16 within +-0.9; beyond, clamped.
/// Source: the SPZ library and its format description (Niantic, 2024).
#pragma once

#include <array>
#include <cmath>
#include <string>

#include <rye/capture/gzip.hpp>
#include <rye/capture/splat_quantize.hpp>
#include <rye/core/format.hpp>

namespace rye {

/// Header of an SPZ file.
struct SpzHeader {
    std::uint32_t version = 3;
    std::uint32_t count = 0;  ///< number of Gaussians
    int degree = 0;           ///< of the harmonics, 0 to 3
    int fractional_bits = 12; ///< of positions
    bool antialiased = false; ///< true if trained with Antialias::mip
    bool extended = false;    ///< true if other data follow the arrays
};

namespace detail {

inline constexpr std::uint32_t spz_magic = 0x5053474E; // "NGSP"
inline constexpr std::size_t spz_header_size = 16;

/// Returns the size of a quaternion in a version of the format [bytes].
inline std::uint64_t spz_rotation_size(const SpzHeader& h) { return h.version == 2 ? 3 : 4; }

/// Returns a coefficient of the harmonics as a byte of `bits` significant bits: steps of 2^(8 -
/// bits).
template <Real T>
std::uint8_t spz_harmonic(T x, int bits) {
    const int step = 1 << (8 - bits);
    const T bounded = std::clamp(x, T(-2), T(2)); // before lround, which may fail
    const int q = static_cast<int>(std::lround(bounded * T(128) / static_cast<T>(step))) * step;
    return static_cast<std::uint8_t>(std::clamp(q + 128, 0, 255));
}

/// Returns the three smaller components in the order x y z w, 10 bits each, and the index of the
/// largest.
template <Real T>
std::uint32_t spz_rotation(const Quat<T>& q) {
    const std::array<T, 4> xyzw{q[1], q[2], q[3], q[0]};
    std::size_t largest = 0;
    for (std::size_t k = 1; k < 4; ++k)
        if (std::abs(xyzw[k]) > std::abs(xyzw[largest])) largest = k;
    auto packed = static_cast<std::uint32_t>(largest);
    for (std::size_t k = 0; k < 4; ++k) {
        if (k == largest) continue;
        const T share = std::abs(xyzw[k]) * T(1.4142135623730951); // of the largest possible value
        const auto size = static_cast<std::uint32_t>(std::lround(std::min(share, T(1)) * T(511)));
        const bool negative = (xyzw[k] < T(0)) != (xyzw[largest] < T(0));
        packed = packed << 10U | (negative ? 512U : 0U) | size;
    }
    return packed;
}

template <Real T>
Quat<T> spz_rotation(std::uint32_t packed) {
    const std::size_t largest = packed >> 30U;
    std::array<T, 4> xyzw{};
    T squares = 0;
    for (std::size_t k = 4; k-- > 0;) {
        if (k == largest) continue;
        const T size = static_cast<T>(packed & 511U) / T(511) * T(0.7071067811865476);
        xyzw[k] = (packed & 512U) != 0 ? -size : size;
        squares += size * size;
        packed >>= 10U;
    }
    xyzw[largest] = std::sqrt(std::max(T(0), T(1) - squares));
    return {xyzw[3], xyzw[0], xyzw[1], xyzw[2]};
}

/// Returns the number of fractional bits that holds the largest coordinate in 24 bits, at most 12.
template <Real T>
int spz_fractional_bits(const GaussianCloud<T>& cloud) {
    const T extent = cloud.count() == 0 ? T(0) : cloud.mean.cwiseAbs().maxCoeff();
    for (int bits = 12; bits >= 0; --bits)
        if (extent * static_cast<T>(1 << bits) < T((1 << 23) - 1)) return bits;
    throw Error("spz_bytes: a mean has a coordinate of " + number_text(extent) +
                ", expected below " + std::to_string((1 << 23) - 1));
}

} // namespace detail

/// Returns the header of the data inside an SPZ file, of which the first 16 bytes suffice; `whole`
/// is the size of all data [bytes]. Throws an Error for another kind of data, a version other than
/// 2 or 3, a degree above 3, and arrays of another size than the data's.
inline SpzHeader parse_spz_header(ByteSpan data, std::uint64_t whole, const std::string& who) {
    SpzHeader h;
    const auto word = [&](std::uint64_t at) {
        return read_at<std::uint32_t>(data, at, who, "the SPZ header");
    };
    const auto byte = [&](std::uint64_t at) {
        return static_cast<int>(read_at<std::uint8_t>(data, at, who, "the SPZ header"));
    };
    require(word(0) == detail::spz_magic, who, "the data do not begin with \"NGSP\": not SPZ");
    h.version = word(4);
    h.count = word(8);
    h.degree = byte(12);
    h.fractional_bits = byte(13);
    h.antialiased = (byte(14) & 1) != 0;
    h.extended = (byte(14) & 2) != 0;
    require(h.version == 2 || h.version == 3, who, "got SPZ version ", h.version,
            ", expected 2 or 3");
    require(h.degree <= 3, who, "got harmonics of degree ", h.degree, ", expected 0 to 3");
    require(h.fractional_bits < 24, who, "got ", h.fractional_bits,
            " fractional bits, expected 0 to 23");
    const auto rest = static_cast<std::uint64_t>(3 * (sh_count(h.degree) - 1));
    const std::uint64_t each = 9 + 1 + 3 + 3 + detail::spz_rotation_size(h) + rest;
    const std::uint64_t size = detail::spz_header_size + each * h.count;
    require(h.extended ? whole >= size : whole == size, who, "got ", whole,
            " bytes of data, expected ", size, " for ", h.count, " Gaussians of degree ", h.degree);
    return h;
}

/// Returns the header of complete data.
inline SpzHeader parse_spz_header(ByteSpan data, const std::string& who) {
    return parse_spz_header(data, data.size(), who);
}

/// Returns the cloud in the bytes of an SPZ file; messages begin with `who`. Throws an Error as
/// gunzip and parse_spz_header do, and, before they are allocated, for data and Gaussians of more
/// bytes than `memory`. Every number returned is finite.
template <Real T>
GaussianCloud<T> parse_spz(ByteSpan file, const std::string& who,
                           std::uint64_t memory = default_memory) {
    const GzipContents contents = gzip_contents(file, who);
    const Bytes beginning = inflate_beginning(
        contents.deflated, std::min<std::size_t>(contents.size, detail::spz_header_size), who);
    const SpzHeader h = parse_spz_header(beginning, contents.size, who);
    const auto n = static_cast<Index>(h.count);
    require_inflatable(contents.deflated, contents.size, who);
    require_memory(saturated_sum(contents.size, GaussianCloud<T>::memory(n, h.degree)), memory, who,
                   "its " + std::to_string(h.count) + " Gaussians");
    const Bytes data = gunzip(contents, who, memory);
    GaussianCloud<T> cloud(n, h.degree);
    const std::byte* at = data.data() + detail::spz_header_size;
    const auto byte = [&] { return static_cast<T>(std::to_integer<int>(*at++)); };
    const T unit = T(1) / static_cast<T>(1 << h.fractional_bits);
    for (Index i = 0; i < 3 * n; ++i, at += 3) {
        std::uint32_t bits = 0;
        std::memcpy(&bits, at, 3);
        const int fixed = static_cast<int>(bits) - ((bits & 0x800000U) != 0 ? 1 << 24 : 0);
        cloud.mean.data()[i] = static_cast<T>(i % 3 == 0 ? fixed : -fixed) * unit;
    }
    for (Index i = 0; i < n; ++i)
        cloud.logit_opacity(0, i) = detail::bounded_logit(byte() / T(255));
    for (Index i = 0; i < 3 * n; ++i)
        cloud.sh_constant.data()[i] = (byte() / T(255) - T(0.5)) / T(0.15);
    for (Index i = 0; i < 3 * n; ++i) cloud.log_scale.data()[i] = byte() / T(16) - T(10);
    for (Index i = 0; i < n; ++i) {
        Quat<T> q;
        if (h.version == 2) {
            T squares = 0;
            for (int k = 1; k < 4; ++k) {
                q[k] = byte() / T(127.5) - T(1);
                squares += q[k] * q[k];
            }
            q[0] = std::sqrt(std::max(T(0), T(1) - squares));
        } else {
            std::uint32_t packed = 0;
            std::memcpy(&packed, at, sizeof packed);
            at += sizeof packed;
            q = detail::spz_rotation<T>(packed);
        }
        cloud.rotation.col(i) = Quat<T>(q[0], q[1], -q[2], -q[3]);
    }
    const Index more = cloud.sh_rest.rows() / 3;
    for (Index i = 0; i < n; ++i)
        for (Index k = 0; k < more; ++k)
            for (Index c = 0; c < 3; ++c)
                cloud.sh_rest(c * more + k, i) =
                    static_cast<T>(detail::sh_half_turn[static_cast<std::size_t>(k)]) *
                    (byte() - T(128)) / T(128);
    return cloud;
}

/// Returns the bytes of an SPZ file of version 3. Rounds and clamps numbers as stated above. Throws
/// an Error for a cloud of degree 4, numbers that are not finite, or means beyond 24 bits.
template <Real T>
Bytes spz_bytes(const GaussianCloud<T>& cloud, const Deflate& deflate = stored_deflate,
                bool antialiased = false) {
    const std::string who = "spz_bytes";
    detail::check_storable(cloud, who);
    require(cloud.degree() <= 3, who, "got harmonics of degree ", cloud.degree(),
            ", expected at most 3: see truncated()");
    const std::int64_t count = cloud.count();
    require(count < (std::int64_t(1) << 32U), who, "got ", count,
            " Gaussians, expected fewer than 2^32");
    const int bits = detail::spz_fractional_bits(cloud);
    Bytes data;
    append(data, detail::spz_magic);
    append(data, std::uint32_t(3));
    append(data, static_cast<std::uint32_t>(count));
    for (const int b : {cloud.degree(), bits, antialiased ? 1 : 0, 0})
        append(data, static_cast<std::uint8_t>(b));
    const auto one = static_cast<T>(1 << bits);
    for (Index i = 0; i < cloud.mean.size(); ++i) {
        const T x = i % 3 == 0 ? cloud.mean.data()[i] : -cloud.mean.data()[i];
        const auto fixed = static_cast<std::uint32_t>(std::lround(x * one));
        for (const unsigned shift : {0U, 8U, 16U})
            append(data, static_cast<std::uint8_t>(fixed >> shift));
    }
    for (Index i = 0; i < cloud.count(); ++i)
        append(data, detail::nearest_byte(sigmoid(cloud.logit_opacity(0, i)) * T(255)));
    for (Index i = 0; i < cloud.sh_constant.size(); ++i)
        append(data,
               detail::nearest_byte(cloud.sh_constant.data()[i] * (T(0.15) * T(255)) + T(127.5)));
    for (Index i = 0; i < cloud.log_scale.size(); ++i)
        append(data, detail::nearest_byte((cloud.log_scale.data()[i] + T(10)) * T(16)));
    for (Index i = 0; i < cloud.count(); ++i) {
        const Quat<T> q = quat_normalized<T>(cloud.rotation.col(i));
        append(data, detail::spz_rotation<T>(Quat<T>(q[0], q[1], -q[2], -q[3])));
    }
    const Index more = cloud.sh_rest.rows() / 3;
    for (Index i = 0; i < cloud.count(); ++i)
        for (Index k = 0; k < more; ++k)
            for (Index c = 0; c < 3; ++c)
                append(data, detail::spz_harmonic(
                                 static_cast<T>(detail::sh_half_turn[static_cast<std::size_t>(k)]) *
                                     cloud.sh_rest(c * more + k, i),
                                 k < 3 ? 5 : 4));
    return gzip_bytes(data, deflate);
}

} // namespace rye
