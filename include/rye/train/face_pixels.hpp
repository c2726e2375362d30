// SPDX-License-Identifier: Apache-2.0
/// rye/train/face_pixels.hpp: what a pixel of the face alone should show in stage 2, how much it
/// counts, and how terms of the eyes are averaged. Formulas for numbers, duals and device code; the
/// objective that uses them is in train/avatar_objective.hpp.
#pragma once

#include <rye/core/columns.hpp>
#include <rye/core/concepts.hpp>

namespace rye::detail {

/// A colour of the picture over another background, which differs by `change`; `beyond`: 1 - mask.
template <class T>
RYE_HD T face_alone_colour(const T& truth, const T& change, const T& beyond) {
    return truth + change * beyond;
}
/// Visible pixels that show nothing of the eyes.
template <class T>
RYE_HD T face_alone_weight(const T& eye, const T& visible) {
    return eye > T(0) ? T(0) : visible;
}

/// The blank's colour in the eyes, what the face alone shows beside them.
template <class T>
RYE_HD T blank_eyeball_colour(const T& shown, const T& eye, const T& blank) {
    return shown + eye * (blank - shown);
}
/// Visible pixels that show an eye, or would show an eyeball if there were no face.
template <class T>
RYE_HD T blank_eyeball_weight(const T& eye, const T& eyeball_alpha, const T& visible) {
    const bool seen = eye > T(0) || eyeball_alpha > T(0.5);
    return seen ? visible : T(0);
}

/// What an average over `pixels` is multiplied by to be one over a mask, from the mask's sum: at
/// least 8 pixels; 0 for an empty mask.
struct EyeGain {
    Index pixels;

    RYE_HD double operator()(double sum) const {
        return sum > 0 ? static_cast<double>(pixels) / (sum < 8.0 ? 8.0 : sum) : 0.0;
    }
};

} // namespace rye::detail
