// SPDX-License-Identifier: Apache-2.0
/// drawing/linear_bases.hpp: a trained avatar as linear bases of its exported Gaussians.
#pragma once

#include <rye/avatar/playable.hpp>
#include <rye/io/splat_bases.hpp>

#include "model/run.hpp"

namespace rye::trainer {

/// The smallest lengths of changes that are kept; shorter ones are 0, and an entry of zeros is left
/// out.
struct BasisBounds {
    float centre = 5e-3F; ///< of the half-width of the Gaussians' box: about a pixel in 512
    float turn = 0.05F;   ///< [rad]
    float log_scale = 0.08F;
    float colour = 6.0F / 255;
    float opacity = 6.0F / 255;
};

/// The inputs of bases.
struct BasesOf {
    const TrainState& state;
    const Drivers<float>& rest;            ///< those of the splat file
    const DriverRanges<float>& ranges;     ///< whose ends the bases are exact at
    const std::vector<std::string>& names; ///< of the coefficients, or none
    bool half_turn = false;                ///< axes: y down, z forward, not the world's
    BasisBounds bounds = {};
};

/// Returns a basis for each coefficient, and each eye's pitch and yaw, toward each end of its range
/// that is a tenth of it or more away from rest: the change of the Gaussians from rest to that end.
/// The eyeballs turn rigidly, and of their changes with the gaze only the rest is in a basis.
/// Throws an Error for a run with another gaze mechanism than rotation.
SplatBases linear_bases(const BasesOf& of);

} // namespace rye::trainer
