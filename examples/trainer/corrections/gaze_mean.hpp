// SPDX-License-Identifier: Apache-2.0
/// corrections/gaze_mean.hpp: how much of a difference that the gazes of all frames have from their
/// irises is the labels' error.
#pragma once

#include <cmath>

#include <rye/core/columns.hpp>

#include "data/degrees.hpp"

namespace rye::trainer {

/// Returns the part of a mean difference, seen minus labelled (pitch, yaw) [rad], by which the
/// labels are off. `variance`: of the mean of the labels' errors [rad^2], that of a label over the
/// number of frames; pictures have a bias of 0.7 degrees. Zero if both do not explain the
/// difference: it belongs to the visual axis.
inline Vec2<double> mean_error_of_labels(const Vec2<double>& mean, double variance) {
    constexpr double bias = 0.7 * degree;
    const double both = variance + bias * bias;
    if (mean.norm() > 3 * std::sqrt(2 * both)) return Vec2<double>::Zero();
    return mean * (variance / both);
}

} // namespace rye::trainer
