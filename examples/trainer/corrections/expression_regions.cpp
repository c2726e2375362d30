// SPDX-License-Identifier: Apache-2.0
#include "corrections/expression_regions.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <string_view>
#include <utility>

#include <rye/avatar/idle_head.hpp>

#include "data/expression_shapes.hpp"

namespace rye::trainer {
namespace {

/// Smallest reach, and the distance over which it falls off relative to the distance of the eyes.
constexpr double least = 0.05, falloff = 0.45;

/// First and last index of runs of landmarks.
using Runs = std::vector<std::pair<Index, Index>>;

struct Region {
    std::string_view name;
    Runs landmarks;
};

/// Returns the regions, with the beginnings of their names. Cheeks are the sides of the jaw's line,
/// of the nose and of the mouth, and the lower lids.
const std::vector<Region>& regions() {
    static const std::vector<Region> all = {
        {"brow", {{17, 26}}},
        {"eye", {{36, 47}}},
        {"nose", {{27, 35}}},
        {"cheek", {{1, 5}, {11, 15}, {31, 31}, {35, 35}, {40, 41}, {46, 47}, {58, 58}, {62, 62}}},
        {"jaw", {{2, 14}, {48, 65}}},
        {"mouth", {{48, 65}}},
        {"tongue", {{48, 65}}},
    };
    return all;
}

struct NamedRegion {
    const Region* region = nullptr;
    int side = 0; ///< 1: the subject's left, -1: right, 0: both
};

/// Returns the region of a name. jawLeft and mouthRight are directions, not sides.
NamedRegion region_of(const std::string& name) {
    std::string word = name;
    std::transform(word.begin(), word.end(), word.begin(), [](char c) {
        return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
    });
    for (const Region& r : regions()) {
        if (!word.starts_with(r.name)) continue;
        const std::string_view rest = std::string_view(word).substr(r.name.size());
        int side = 0;
        if (rest.ends_with("_l") || (rest.ends_with("left") && rest.size() > 4)) side = 1;
        if (rest.ends_with("_r") || (rest.ends_with("right") && rest.size() > 5)) side = -1;
        return {&r, side};
    }
    return {};
}

} // namespace

Columns<double> expression_reach(const std::vector<std::string>& names,
                                 const Columns<double>& landmarks) {
    const auto centre = [&](Index begin) {
        return Vec3<double>(landmarks.middleCols(begin, 6).rowwise().mean());
    };
    const Vec3<double> right = centre(36), left = centre(42);
    const double eyes = (left - right).norm(), middle = (left.x() + right.x()) / 2;
    Columns<double> reach =
        Columns<double>::Ones(static_cast<Index>(names.size()), landmarks.cols());
    bool any = false;
    for (Index e = 0; e < reach.rows(); ++e) {
        const NamedRegion named = region_of(names[static_cast<std::size_t>(e)]);
        if (named.region == nullptr) continue;
        any = true;
        for (Index l = 0; l < landmarks.cols(); ++l) {
            double nearest = std::numeric_limits<double>::infinity();
            for (const auto& [first, last] : named.region->landmarks)
                for (Index k = first; k <= last; ++k)
                    if (named.side * (landmarks(0, k) - middle) >= -0.03 * eyes)
                        nearest =
                            std::min(nearest, (landmarks.col(l) - landmarks.col(k)).norm() / eyes);
            reach(e, l) = least + (1 - least) * std::exp(-nearest * nearest / (falloff * falloff));
        }
    }
    return any ? reach : Columns<double>();
}

RegressionConfig expression_prior(const Capture& capture, const Subject& subject,
                                  const MeshTrainConfig& config) {
    RegressionConfig prior;
    const auto count = static_cast<Index>(capture.expression_names.size());
    for (const LidCoefficient<double>& lid :
         lid_coefficients(capture.expression_names, VecX<double>(VecX<double>::Ones(count))).blink)
        prior.blinks.push_back(lid.index);
    if (config.fit_regions)
        prior.expression_reach = expression_reach(capture.expression_names, subject.neutral);
    if (config.fit_shapes) prior.expression_shapes = expression_shapes(capture);
    // With known shapes, gaze comes first to explain their remainder.
    if (prior.expression_shapes.size() > 0)
        prior.expression_reach = Columns<double>::Constant(prior.expression_shapes.rows(),
                                                           subject.neutral.cols(), least);
    return prior;
}

} // namespace rye::trainer
