// SPDX-License-Identifier: Apache-2.0
/// rye/io/glb.hpp: Gaussians as a binary glTF 2.0 file with KHR_gaussian_splatting: points
/// with POSITION, rotation (x, y, z, w), scale (a standard deviation), opacity (0..1) and a VEC3 of
/// red, green, blue for each harmonic, all floats, so nothing is rounded; and COLOR_0, for programs
/// that draw points only: the colour of band 0 in linear light, and the opacity, 16 bits each. Axes
/// of glTF: x right, y up, z toward the viewer; clouds have those of a PLY, and are rotated by half
/// a turn about x. gltf.hpp reads it.
/// Source: glTF 2.0 specification, 4.4; KHR_gaussian_splatting, its text of July 2026, a release
/// candidate.
#pragma once

#include <cmath>
#include <string>

#include <rye/io/bytes.hpp>
#include <rye/io/splat_quantize.hpp>
#include <rye/core/format.hpp>
#include <rye/math/srgb.hpp>

namespace rye {

namespace detail {

/// Arrays of the file and the text that describes them, which grow together.
struct GlbArrays {
    Bytes data;
    std::string attributes, accessors, views;
    int count = 0;

    /// Adds N columns of 1, 3 or 4 floats, or 16-bit shares of 1; `bounds` is empty or
    /// ,"min":[..],"max":[..].
    template <class N>
    void add(const std::string& name, const Columns<N>& a, const std::string& bounds = "") {
        const std::string comma = count == 0 ? "" : ",", index = std::to_string(count);
        const char* const kind = a.rows() == 1 ? "SCALAR" : a.rows() == 3 ? "VEC3" : "VEC4";
        const char* const number = std::is_same_v<N, float> ? "5126" : "5123,\"normalized\":true";
        const std::size_t bytes = sizeof(N) * static_cast<std::size_t>(a.size());
        attributes += comma + "\"" + name + "\":" + index;
        accessors += comma + "{\"bufferView\":" + index + ",\"componentType\":" + number +
                     ",\"count\":" + std::to_string(a.cols()) + ",\"type\":\"" + kind + "\"" +
                     bounds + "}";
        views += comma + "{\"buffer\":0,\"byteOffset\":" + std::to_string(data.size()) +
                 ",\"byteLength\":" + std::to_string(bytes) + ",\"target\":34962}";
        append(data, {reinterpret_cast<const std::byte*>(a.data()), bytes});
        ++count;
    }
};

template <Real T>
Columns<float> glb_floats(const char* field, const Columns<T>& a) {
    const Columns<float> r = a.template cast<float>();
    if (!r.allFinite())
        throw Error("glb_bytes: " + std::string(field) + " has a number beyond the range of float");
    return r;
}

/// Returns COLOR_0 of each Gaussian: red, green, blue in linear light and opacity, as shares of 1.
template <Real T>
Columns<std::uint16_t> glb_colours(const GaussianCloud<T>& cloud) {
    Columns<std::uint16_t> out(4, cloud.count());
    const auto share = [](double x) {
        return static_cast<std::uint16_t>(std::lround(65535 * std::clamp(x, 0.0, 1.0)));
    };
    for (Index i = 0; i < cloud.count(); ++i) {
        for (Index k = 0; k < 3; ++k) {
            const double stored = 0.5 + sh_factor(0) * static_cast<double>(cloud.sh_constant(k, i));
            out(k, i) = share(linear_from_srgb(std::clamp(stored, 0.0, 1.0)));
        }
        out(3, i) = share(static_cast<double>(sigmoid(cloud.logit_opacity(0, i))));
    }
    return out;
}

} // namespace detail

/// Returns the bytes of a GLB file of one scene with one cloud. Throws an Error for an empty cloud
/// (glTF has no empty arrays), harmonics of degree 4, numbers that are not finite, and 4 GiB or
/// more.
template <Real T>
Bytes glb_bytes(const GaussianCloud<T>& cloud) {
    const std::string who = "glb_bytes";
    detail::check_storable(cloud, who);
    require(cloud.count() > 0, who,
            "got no Gaussians, expected at least one: glTF has no empty "
            "arrays");
    require(cloud.degree() <= 3, who, "got harmonics of degree ", cloud.degree(),
            ", expected at most 3: see truncated()");
    const Index n = cloud.count(), more = cloud.sh_rest.rows() / 3;
    detail::GlbArrays arrays;
    Columns<float> mean = detail::glb_floats("mean", cloud.mean);
    mean.bottomRows(2) *= -1.0F;
    std::string least, most;
    for (Index k = 0; k < 3; ++k) {
        least += (k > 0 ? "," : "") + number_text(mean.row(k).minCoeff());
        most += (k > 0 ? "," : "") + number_text(mean.row(k).maxCoeff());
    }
    arrays.add("POSITION", mean, ",\"min\":[" + least + "],\"max\":[" + most + "]");
    arrays.add("COLOR_0", detail::glb_colours(cloud));
    const std::string stem = "KHR_gaussian_splatting:";
    Columns<T> part(4, n);
    for (Index i = 0; i < n; ++i) {
        const Quat<T> q = quat_normalized<T>(cloud.rotation.col(i));
        part.col(i) = Vec4<T>(q[1], -q[2], -q[3], q[0]);
    }
    arrays.add(stem + "ROTATION", detail::glb_floats("rotation", part));
    part = cloud.log_scale.unaryExpr([](const T& s) { return std::exp(s); });
    arrays.add(stem + "SCALE", detail::glb_floats("scale", part));
    part = cloud.logit_opacity.unaryExpr([](const T& o) { return sigmoid(o); });
    arrays.add(stem + "OPACITY", detail::glb_floats("opacity", part));
    arrays.add(stem + "SH_DEGREE_0_COEF_0", detail::glb_floats("sh_constant", cloud.sh_constant));
    for (Index k = 0, degree = 1; k < more; ++degree)
        for (Index order = 0; order < 2 * degree + 1; ++order, ++k) {
            const auto sign = static_cast<T>(detail::sh_half_turn[static_cast<std::size_t>(k)]);
            part.resize(3, n);
            for (Index c = 0; c < 3; ++c) part.row(c) = sign * cloud.sh_rest.row(c * more + k);
            arrays.add(
                stem + "SH_DEGREE_" + std::to_string(degree) + "_COEF_" + std::to_string(order),
                detail::glb_floats("sh_rest", part));
        }
    std::string json =
        "{\"asset\":{\"version\":\"2.0\",\"generator\":\"rye\"},"
        "\"extensionsUsed\":[\"KHR_gaussian_splatting\"],\"scene\":0,\"scenes\":[{\"nodes\":[0]}],"
        "\"nodes\":[{\"mesh\":0}],\"meshes\":[{\"primitives\":[{\"mode\":0,\"attributes\":{" +
        arrays.attributes +
        "},\"extensions\":{\"KHR_gaussian_splatting\":{\"kernel\":\"ellipse\",\"colorSpace\":"
        "\"srgb_rec709_display\",\"sortingMethod\":\"cameraDistance\",\"projection\":"
        "\"perspective\"}}}]}],\"accessors\":[" +
        arrays.accessors + "],\"bufferViews\":[" + arrays.views +
        "],\"buffers\":[{\"byteLength\":" + std::to_string(arrays.data.size()) + "}]}";
    json.resize((json.size() + 3) / 4 * 4, ' ');
    const std::uint64_t size = 12 + 8 + json.size() + 8 + arrays.data.size();
    require(size < (std::uint64_t(1) << 32U), who, "got ", size,
            " bytes, expected fewer than 2^32");
    Bytes out;
    out.reserve(static_cast<std::size_t>(size));
    append(out, std::uint32_t(0x46546C67)); // "glTF"
    append(out, std::uint32_t(2));
    append(out, static_cast<std::uint32_t>(size));
    append(out, static_cast<std::uint32_t>(json.size()));
    append(out, std::uint32_t(0x4E4F534A)); // "JSON"
    append(out, as_bytes(json));
    append(out, static_cast<std::uint32_t>(arrays.data.size()));
    append(out, std::uint32_t(0x004E4942)); // "BIN"
    append(out, ByteSpan(arrays.data));
    return out;
}

} // namespace rye
