// SPDX-License-Identifier: Apache-2.0
/// rye/io/spz_arrays.hpp: the arrays that an SPZ file of any version holds, one for each
/// attribute: positions as 24-bit fixed point (version 1: float16), opacity 0..255, colour of band
/// 0 as 0.15 f_dc 255 + 127.5, log scale as 16 (s + 10), quaternions as the three smaller
/// components (below version 3: x, y and z in a byte each), harmonics as 128 + 128 c in steps of 8
/// in band 1 and of 16 above. Axes of the file are x right, y up, z toward the viewer; clouds have
/// those of a PLY.
/// Source: the SPZ library and its format description (Niantic, 2024 to 2026).
#pragma once

#include <array>
#include <cmath>
#include <string>

#include <rye/io/bytes.hpp>
#include <rye/io/splat_quantize.hpp>
#include <rye/core/format.hpp>

namespace rye::detail {

/// Header of an SPZ file.
struct SpzHeader {
    std::uint32_t version = 3; ///< 1 to 3: inside gzip; 4: arrays inside zstd
    std::uint32_t count = 0;   ///< number of Gaussians
    int degree = 0;            ///< of the harmonics, 0 to 4
    int fractional_bits = 12;  ///< of positions
    bool antialiased = false;  ///< true if trained with Antialias::mip
    bool extended = false;     ///< true if there are records of extensions
};

inline constexpr std::uint32_t spz_magic = 0x5053474E; // "NGSP"

/// Names of the arrays, in the order of the file.
inline constexpr std::array<const char*, 6> spz_array_names{"positions", "opacities", "colours",
                                                            "scales",    "rotations", "harmonics"};

/// Arrays of an SPZ file, in that order.
using SpzArrays = std::array<ByteSpan, 6>;

/// Returns the bytes a Gaussian of each array.
inline std::array<std::uint64_t, 6> spz_sizes(const SpzHeader& h) {
    return {h.version == 1 ? 6U : 9U,
            1,
            3,
            3,
            h.version < 3 ? 3U : 4U,
            static_cast<std::uint64_t>(3 * (sh_count(h.degree) - 1))};
}

/// Returns the fields that all versions share; throws an Error for a degree above 4 or fractional
/// bits above 23.
inline SpzHeader spz_common_header(ByteSpan data, const std::string& who) {
    SpzHeader h;
    const auto word = [&](std::uint64_t at) {
        return read_at<std::uint32_t>(data, at, who, "the SPZ header");
    };
    const auto byte = [&](std::uint64_t at) {
        return static_cast<int>(read_at<std::uint8_t>(data, at, who, "the SPZ header"));
    };
    require(word(0) == spz_magic, who, "the data do not begin with \"NGSP\": not SPZ");
    h.version = word(4);
    h.count = word(8);
    h.degree = byte(12);
    h.fractional_bits = byte(13);
    h.antialiased = (byte(14) & 1) != 0;
    h.extended = (byte(14) & 2) != 0;
    require(h.degree <= 4, who, "got harmonics of degree ", h.degree, ", expected 0 to 4");
    require(h.fractional_bits < 24, who, "got ", h.fractional_bits,
            " fractional bits, expected 0 to 23");
    return h;
}

/// Throws an Error if records of extensions name axes other than x right, y up, z toward the
/// viewer; others are skipped. A record: type and length of its payload, 32 bits each, payload.
inline void require_spz_axes(ByteSpan records, const std::string& who) {
    constexpr std::uint32_t coordinate_system = 0xADBE0003, right_up_back = 4;
    while (records.size() >= 8) {
        const auto type = read_at<std::uint32_t>(records, 0, who, "an SPZ extension");
        const auto length = read_at<std::uint32_t>(records, 4, who, "an SPZ extension");
        const ByteSpan payload = slice(records, 8, length, who, "an SPZ extension");
        records = records.subspan(8 + payload.size());
        if (type != coordinate_system) continue;
        const auto axes = read_at<std::uint32_t>(payload, 0, who, "SPZ_ADOBE_coordinate_system");
        require(axes == 0 || axes == right_up_back, who, "SPZ_ADOBE_coordinate_system is ", axes,
                ", expected 4 (x right, y up, z toward the viewer)");
    }
}

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

/// Fills the means, 3 N numbers in the file's axes; throws an Error for a float16 that is not
/// finite.
template <Real T>
void read_spz_positions(const SpzHeader& h, ByteSpan bytes, Columns<T>& mean,
                        const std::string& who) {
    const T unit = T(1) / static_cast<T>(1 << h.fractional_bits);
    const std::byte* at = bytes.data();
    for (Index i = 0; i < mean.size(); ++i) {
        T x = 0;
        if (h.version == 1) {
            Eigen::half half;
            std::memcpy(static_cast<void*>(&half), at, 2);
            at += 2;
            x = static_cast<T>(static_cast<float>(half));
            if (!std::isfinite(x))
                throw Error(who + ": position " + "xyz"[i % 3] + " of Gaussian " +
                            std::to_string(i / 3) + " is " + number_text(x) +
                            ", expected a finite number");
        } else {
            std::uint32_t bits = 0;
            std::memcpy(&bits, at, 3);
            at += 3;
            x = unit *
                static_cast<T>(static_cast<int>(bits) - ((bits & 0x800000U) != 0 ? 1 << 24 : 0));
        }
        mean.data()[i] = i % 3 == 0 ? x : -x;
    }
}

/// Returns the cloud of arrays that have the sizes of spz_sizes times the count. Every number is
/// finite.
template <Real T>
GaussianCloud<T> spz_cloud(const SpzHeader& h, const SpzArrays& arrays, const std::string& who) {
    const auto n = static_cast<Index>(h.count);
    GaussianCloud<T> cloud(n, h.degree);
    const auto byte = [&](std::size_t array, Index i) {
        const auto at = static_cast<std::size_t>(i);
        return static_cast<T>(std::to_integer<int>(arrays[array][at]));
    };
    read_spz_positions(h, arrays[0], cloud.mean, who);
    for (Index i = 0; i < n; ++i) cloud.logit_opacity(0, i) = bounded_logit(byte(1, i) / T(255));
    for (Index i = 0; i < 3 * n; ++i) {
        cloud.sh_constant.data()[i] = (byte(2, i) / T(255) - T(0.5)) / T(0.15);
        cloud.log_scale.data()[i] = byte(3, i) / T(16) - T(10);
    }
    for (Index i = 0; i < n; ++i) {
        Quat<T> q;
        if (h.version < 3) {
            T squares = 0;
            for (int k = 1; k < 4; ++k) {
                q[k] = byte(4, 3 * i + k - 1) / T(127.5) - T(1);
                squares += q[k] * q[k];
            }
            q[0] = std::sqrt(std::max(T(0), T(1) - squares));
        } else {
            std::uint32_t packed = 0;
            std::memcpy(&packed, arrays[4].data() + 4 * i, sizeof packed);
            q = spz_rotation<T>(packed);
        }
        cloud.rotation.col(i) = Quat<T>(q[0], q[1], -q[2], -q[3]);
    }
    const Index more = cloud.sh_rest.rows() / 3;
    for (Index i = 0, at = 0; i < n; ++i)
        for (Index k = 0; k < more; ++k)
            for (Index c = 0; c < 3; ++c)
                cloud.sh_rest(c * more + k, i) =
                    static_cast<T>(sh_half_turn[static_cast<std::size_t>(k)]) *
                    (byte(5, at++) - T(128)) / T(128);
    return cloud;
}

/// Returns the header of a cloud. Throws an Error for more Gaussians than 32 bits count, numbers
/// that are not finite, or means beyond 24 bits.
template <Real T>
SpzHeader spz_header(const GaussianCloud<T>& cloud, std::uint32_t version, bool antialiased,
                     const std::string& who) {
    check_storable(cloud, who);
    const std::int64_t count = cloud.count();
    require(count < (std::int64_t(1) << 32U), who, "got ", count,
            " Gaussians, expected fewer than 2^32");
    return {version,        static_cast<std::uint32_t>(count),
            cloud.degree(), spz_fractional_bits(cloud),
            antialiased,    false};
}

/// Returns the first 16 bytes of a file; the last is another field in each version.
inline Bytes spz_header_bytes(const SpzHeader& h, int last) {
    Bytes data;
    append(data, spz_magic);
    append(data, h.version);
    append(data, h.count);
    for (const int b : {h.degree, h.fractional_bits, h.antialiased ? 1 : 0, last})
        append(data, static_cast<std::uint8_t>(b));
    return data;
}

/// Returns the arrays of a cloud whose header is of version 3 or 4.
template <Real T>
std::array<Bytes, 6> spz_array_bytes(const SpzHeader& h, const GaussianCloud<T>& cloud) {
    std::array<Bytes, 6> out;
    const auto one = static_cast<T>(1 << h.fractional_bits);
    for (Index i = 0; i < cloud.mean.size(); ++i) {
        const T x = i % 3 == 0 ? cloud.mean.data()[i] : -cloud.mean.data()[i];
        const auto fixed = static_cast<std::uint32_t>(std::lround(x * one));
        for (const unsigned shift : {0U, 8U, 16U})
            append(out[0], static_cast<std::uint8_t>(fixed >> shift));
    }
    for (Index i = 0; i < cloud.count(); ++i) {
        append(out[1], nearest_byte(sigmoid(cloud.logit_opacity(0, i)) * T(255)));
        const Quat<T> q = quat_normalized<T>(cloud.rotation.col(i));
        append(out[4], spz_rotation<T>(Quat<T>(q[0], q[1], -q[2], -q[3])));
    }
    for (Index i = 0; i < cloud.mean.size(); ++i) {
        append(out[2], nearest_byte(cloud.sh_constant.data()[i] * (T(0.15) * T(255)) + T(127.5)));
        append(out[3], nearest_byte((cloud.log_scale.data()[i] + T(10)) * T(16)));
    }
    const Index more = cloud.sh_rest.rows() / 3;
    for (Index i = 0; i < cloud.count(); ++i)
        for (Index k = 0; k < more; ++k)
            for (Index c = 0; c < 3; ++c)
                append(out[5],
                       spz_harmonic(static_cast<T>(sh_half_turn[static_cast<std::size_t>(k)]) *
                                        cloud.sh_rest(c * more + k, i),
                                    k < 3 ? 5 : 4));
    return out;
}

} // namespace rye::detail
