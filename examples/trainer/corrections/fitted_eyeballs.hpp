// SPDX-License-Identifier: Apache-2.0
/// corrections/fitted_eyeballs.hpp: eyeballs of a capture that measured none: placed where the gazes of
/// its labels pass through the irises in its pictures.
#pragma once

#include <array>
#include <optional>
#include <vector>

#include "corrections/seen_gazes.hpp"
#include "data/capture.hpp"

namespace rye::trainer {

/// Returns the eyeballs of a head, from those that are assumed. The iris of each frame is where the
/// cameras' rays to it meet; the centre is the point from which the irises lie in the directions of
/// the gazes, in the least squares of their angles, so that errors of gazes shorten nothing. Its
/// prior is the assumed one, 4 mm wide, and that both eyes lie alike. The distance of the irises
/// gives the radius; the iris keeps its size. Needs eye masks, which are off by up to `area_error`
/// radii (estimate_gaze). Nothing if fewer than 6 frames, or less than half of them, have an iris
/// that cameras see from two sides, or if these irises make no eyeball.
std::optional<std::array<EyeballInHead, 2>>
fitted_eyeballs(const Capture& capture, const std::vector<int>& frames,
                const std::array<EyeballInHead, 2>& assumed, double area_error);

} // namespace rye::trainer
