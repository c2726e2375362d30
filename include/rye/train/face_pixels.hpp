// SPDX-License-Identifier: Apache-2.0
/// rye/train/face_pixels.hpp: target and weight of a pixel of the face alone in stage 2, and the
/// average of the eyes' terms. Formulas for numbers, duals and device code, used by the objective
/// of train/avatar_objective.hpp.
#pragma once

#include <rye/core/columns.hpp>
#include <rye/core/concepts.hpp>

namespace rye::detail {

/// Returns a colour of the picture over another background, which differs by `change`; `beyond`: 1
/// - mask.
template <class T>
RYE_HD T face_alone_colour(const T& truth, const T& change, const T& beyond) {
    return truth + change * beyond;
}
/// Returns the weight of a pixel: visible, and showing nothing of the eyes.
template <class T>
RYE_HD T face_alone_weight(const T& eye, const T& visible) {
    return eye > T(0) ? T(0) : visible;
}

/// Factor that turns an average over `pixels` into one over a mask, from the mask's sum: at least 8
/// pixels; 0 for an empty mask.
struct EyeGain {
    Index pixels;

    RYE_HD double operator()(double sum) const {
        return sum > 0 ? static_cast<double>(pixels) / (sum < 8.0 ? 8.0 : sum) : 0.0;
    }
};

} // namespace rye::detail
