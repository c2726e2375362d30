// SPDX-License-Identifier: Apache-2.0
/// rye/train/face_pixels.hpp: target and weight of a pixel of the face alone in stage 2. Formulas
/// for numbers, duals and device code, used by the objective of train/avatar_objective.hpp.
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

} // namespace rye::detail
