// SPDX-License-Identifier: Apache-2.0
/// rye/io/splat_file.hpp: the .splat file of web viewers: 32 bytes per Gaussian, no header.
///     float x, y, z; float scale x, y, z; byte red, green, blue, alpha; byte w, x, y, z
/// Position and scale (a standard deviation, not its logarithm) in world units, in the axes of a
/// PLY; colour of band 0 and opacity as 0..255; quaternion components as 128 + 128 q. The format
/// has no harmonics above band 0. A cloud with colours in 0..1, written and read back, differs by
/// at most 0.5/255 in colour and opacity, and by less than 1 degree in rotation.
/// Source: the converter of "splat" (K. Kwok, 2023).
#pragma once

#include <array>
#include <cmath>
#include <string>

#include <rye/io/bytes.hpp>
#include <rye/io/splat_quantize.hpp>
#include <rye/core/format.hpp>

namespace rye {

namespace detail {

/// Size of a record [bytes].
inline constexpr std::size_t splat_record = 32;

} // namespace detail

/// Returns the bytes of a .splat file, in the cloud's order. Clamps colours to 0..1; drops
/// harmonics above band 0. Throws an Error for numbers that are not finite, before or after
/// conversion to float.
template <Real T>
Bytes splat_bytes(const GaussianCloud<T>& cloud) {
    const std::string who = "splat_bytes";
    detail::check_storable(cloud, who);
    Bytes out;
    out.reserve(detail::splat_record * static_cast<std::size_t>(cloud.count()));
    const auto put = [&](T x, const char* field, Index i) {
        const auto stored = static_cast<float>(x);
        if (!std::isfinite(stored))
            throw Error(who + ": " + field + " of Gaussian " + std::to_string(i) + " is " +
                        number_text(x) + ", beyond the range of float");
        append(out, stored);
    };
    for (Index i = 0; i < cloud.count(); ++i) {
        for (Index k = 0; k < 3; ++k) put(cloud.mean(k, i), "mean", i);
        for (Index k = 0; k < 3; ++k) put(std::exp(cloud.log_scale(k, i)), "scale", i);
        for (Index k = 0; k < 3; ++k)
            append(out, detail::nearest_byte(
                            (T(0.5) + T(detail::sh_factor(0)) * cloud.sh_constant(k, i)) * T(255)));
        append(out, detail::nearest_byte(sigmoid(cloud.logit_opacity(0, i)) * T(255)));
        const Quat<T> q = quat_normalized<T>(cloud.rotation.col(i));
        for (int k = 0; k < 4; ++k) append(out, detail::nearest_byte(q[k] * T(128) + T(128)));
    }
    return out;
}

/// Returns the cloud in the bytes of a .splat file; messages begin with `who`. Throws an Error
/// unless there are whole records of finite positions and of finite scales that are not negative,
/// and for a cloud of more bytes than `memory`.
template <Real T>
GaussianCloud<T> parse_splat(ByteSpan bytes, const std::string& who,
                             std::uint64_t memory = default_memory) {
    require(bytes.size() % detail::splat_record == 0, who, "got ", bytes.size(),
            " bytes, expected a multiple of ", detail::splat_record, ", one record a Gaussian");
    const auto n = static_cast<Index>(bytes.size() / detail::splat_record);
    require_memory(GaussianCloud<T>::memory(n, 0), memory, who, "its Gaussians");
    GaussianCloud<T> cloud(n, 0);
    for (Index i = 0; i < n; ++i) {
        const std::byte* const at =
            bytes.data() + detail::splat_record * static_cast<std::size_t>(i);
        std::array<float, 6> number;
        std::memcpy(number.data(), at, sizeof number);
        for (int k = 0; k < 6; ++k) {
            const float x = number[static_cast<std::size_t>(k)];
            if (!std::isfinite(x) || (k >= 3 && x < 0))
                throw Error(who + ": " + (k < 3 ? "position" : "scale") + " " + "xyz"[k % 3] +
                            " of Gaussian " + std::to_string(i) + " is " + number_text(x) +
                            ", expected a finite number" + (k < 3 ? "" : " of at least 0"));
        }
        const auto byte = [&](int k) { return static_cast<T>(std::to_integer<int>(at[24 + k])); };
        for (int k = 0; k < 3; ++k) {
            const auto s = static_cast<std::size_t>(k);
            cloud.mean(k, i) = static_cast<T>(number[s]);
            cloud.log_scale(k, i) =
                std::log(std::max(static_cast<T>(number[3 + s]), std::numeric_limits<T>::min()));
            cloud.sh_constant(k, i) = (byte(k) / T(255) - T(0.5)) / T(detail::sh_factor(0));
        }
        cloud.logit_opacity(0, i) = detail::bounded_logit(byte(3) / T(255));
        for (int k = 0; k < 4; ++k) cloud.rotation(k, i) = (byte(4 + k) - T(128)) / T(128);
    }
    return cloud;
}

} // namespace rye
