// SPDX-License-Identifier: Apache-2.0
/// rye/io/usda.hpp: Gaussians as a text file of OpenUSD (.usda), one prim
/// ParticleField3DGaussianSplat of OpenUSD 26.03: positions, orientations (w, x, y, z), scales
/// (standard deviations), opacities (0..1) and coefficients of the harmonics, those of a Gaussian
/// together. Numbers are the shortest text of a float, so nothing is rounded beyond that. Axes of
/// the stage: x right, y up, z toward the viewer; clouds have those of a PLY, and are rotated by
/// half a turn about x. A unit of the world is a metre of the stage.
/// Several clouds of the same Gaussians are the frames of a film, at time codes 0, 1, ...: an
/// attribute that moves has a sample for each frame, one that does not has one value.
/// Source: OpenUSD 26.03, UsdVol's schemas of particle fields; its specification of usda.
#pragma once

#include <span>
#include <string>
#include <vector>

#include <rye/io/splat_quantize.hpp>
#include <rye/core/format.hpp>

namespace rye {

namespace detail {

/// Arrays of a cloud as the file has them, a column an element.
struct UsdaArrays {
    Columns<float> positions, orientations, scales, opacities, coefficients;
};

template <Real T>
UsdaArrays usda_arrays(const GaussianCloud<T>& cloud, const std::string& who) {
    check_storable(cloud, who);
    const auto floats = [&](const char* field, const Columns<T>& a) {
        const Columns<float> r = a.template cast<float>();
        if (!r.allFinite())
            throw Error(who + ": " + field + " has a number beyond the range of float");
        return r;
    };
    const Index n = cloud.count(), more = cloud.sh_rest.rows() / 3, each = more + 1;
    UsdaArrays arrays;
    arrays.positions = floats("mean", cloud.mean);
    arrays.positions.bottomRows(2) *= -1.0F;
    Columns<T> part(4, n);
    for (Index i = 0; i < n; ++i) {
        const Quat<T> q = quat_normalized<T>(cloud.rotation.col(i));
        part.col(i) = Vec4<T>(q[0], q[1], -q[2], -q[3]);
    }
    arrays.orientations = floats("rotation", part);
    part = cloud.log_scale.unaryExpr([](const T& s) { return std::exp(s); });
    arrays.scales = floats("scale", part);
    part = cloud.logit_opacity.unaryExpr([](const T& o) { return sigmoid(o); });
    arrays.opacities = floats("opacity", part);
    part.resize(3, n * each);
    for (Index i = 0; i < n; ++i) {
        part.col(i * each) = cloud.sh_constant.col(i);
        for (Index k = 0; k < more; ++k)
            for (Index c = 0; c < 3; ++c)
                part(c, i * each + 1 + k) =
                    static_cast<T>(sh_half_turn[static_cast<std::size_t>(k)]) *
                    cloud.sh_rest(c * more + k, i);
    }
    arrays.coefficients = floats("sh", part);
    return arrays;
}

/// Adds an array: numbers, or tuples of them.
inline void append_usda(std::string& text, const Columns<float>& a) {
    text += '[';
    for (Index i = 0; i < a.cols(); ++i) {
        text += i == 0 ? "" : ", ";
        if (a.rows() > 1) text += '(';
        for (Index k = 0; k < a.rows(); ++k) {
            text += k == 0 ? "" : ", ";
            text += number_text(a(k, i) == 0.0F ? 0.0F : a(k, i)); // never -0
        }
        if (a.rows() > 1) text += ')';
    }
    text += ']';
}

/// Adds an attribute of which each frame has an array: its value, or samples if frames differ.
inline void append_usda(std::string& text, const std::string& name,
                        std::span<const UsdaArrays> frames, Columns<float> UsdaArrays::*array,
                        const std::string& metadata = "") {
    bool moves = false;
    for (const UsdaArrays& frame : frames) moves = moves || frame.*array != frames[0].*array;
    text += "    " + name;
    if (!moves) {
        text += " = ";
        append_usda(text, frames[0].*array);
        text += metadata + '\n';
        return;
    }
    // A declaration has the metadata, samples have none.
    if (!metadata.empty()) text += metadata + "\n    " + name;
    text += ".timeSamples = {\n";
    for (std::size_t k = 0; k < frames.size(); ++k) {
        text += "        " + std::to_string(k) + ": ";
        append_usda(text, frames[k].*array);
        text += ",\n";
    }
    text += "    }\n";
}

/// Returns both corners of the box that has three standard deviations of every Gaussian.
inline Columns<float> usda_extent(const UsdaArrays& frame) {
    Columns<float> box(3, 2);
    const Columns<float> reach = 3 * frame.scales.colwise().maxCoeff().replicate(3, 1);
    box.col(0) = (frame.positions - reach).rowwise().minCoeff();
    box.col(1) = (frame.positions + reach).rowwise().maxCoeff();
    return box;
}

} // namespace detail

/// Returns the text of a .usda file of one cloud, or of frames of the same Gaussians, which a
/// player shows at `rate` a second. Throws an Error for no frame, no Gaussians, frames of different
/// counts or degrees, harmonics of degree 4, and numbers that are not finite.
template <Real T>
std::string usda_text(std::span<const GaussianCloud<T>> frames, double rate = 24) {
    const std::string who = "usda_text";
    require(!frames.empty() && frames[0].count() > 0, who,
            "got no Gaussians, expected at least one");
    const int degree = frames[0].degree();
    require(degree <= 3, who, "got harmonics of degree ", degree,
            ", expected at most 3: see truncated()");
    std::vector<detail::UsdaArrays> arrays;
    for (const GaussianCloud<T>& cloud : frames) {
        require(cloud.count() == frames[0].count() && cloud.degree() == degree, who, "frame ",
                arrays.size(), " has ", cloud.count(), " Gaussians of degree ", cloud.degree(),
                ", expected ", frames[0].count(), " of degree ", degree);
        arrays.push_back(detail::usda_arrays(cloud, who));
    }
    std::string text = "#usda 1.0\n(\n    defaultPrim = \"Splats\"\n";
    if (frames.size() > 1)
        text += "    endTimeCode = " + std::to_string(frames.size() - 1) +
                "\n    framesPerSecond = " + number_text(rate) + '\n';
    text += "    metersPerUnit = 1\n";
    if (frames.size() > 1)
        text += "    startTimeCode = 0\n    timeCodesPerSecond = " + number_text(rate) + '\n';
    text += "    upAxis = \"Y\"\n)\n\ndef ParticleField3DGaussianSplat \"Splats\"\n{\n";
    Columns<float> box = detail::usda_extent(arrays[0]);
    for (const detail::UsdaArrays& frame : arrays) {
        const Columns<float> own = detail::usda_extent(frame);
        box.col(0) = box.col(0).cwiseMin(own.col(0)).eval();
        box.col(1) = box.col(1).cwiseMax(own.col(1)).eval();
    }
    text += "    float3[] extent = ";
    detail::append_usda(text, box);
    text += '\n';
    using detail::UsdaArrays;
    const std::span<const UsdaArrays> all(arrays);
    detail::append_usda(text, "point3f[] positions", all, &UsdaArrays::positions);
    detail::append_usda(text, "quatf[] orientations", all, &UsdaArrays::orientations);
    detail::append_usda(text, "float3[] scales", all, &UsdaArrays::scales);
    detail::append_usda(text, "float[] opacities", all, &UsdaArrays::opacities);
    text += "    uniform int radiance:sphericalHarmonicsDegree = " + std::to_string(degree) + '\n';
    detail::append_usda(text, "float3[] radiance:sphericalHarmonicsCoefficients", all,
                        &UsdaArrays::coefficients,
                        " (\n        elementSize = " + std::to_string(sh_count(degree)) +
                            "\n        interpolation = \"vertex\"\n    )");
    return text +
           "    uniform token projectionModeHint = \"perspective\"\n"
           "    uniform token sortingModeHint = \"zDepth\"\n}\n";
}

} // namespace rye
