// SPDX-License-Identifier: Apache-2.0
/// corrections/found_kappa.hpp: the angle kappa of each eye, from the irises in a capture's
/// training pictures and the visual axes of its labels. Training alone does not find it: eyes whose
/// colours are free paint the iris where the labels look.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "data/capture.hpp"

namespace rye::trainer {

/// Kappa of both eyes, left and right.
struct FoundKappa {
    /// Optical minus visual axis, (pitch, yaw) [rad]; 0 for an eye that too few frames show.
    std::array<Vec2<double>, 2> angles{Vec2<double>::Zero(), Vec2<double>::Zero()};
    std::array<int, 2> frames{0, 0}; ///< number whose irises are seen

    /// Returns a sentence about each eye.
    std::vector<std::string> lines() const;
};

/// Returns the medians over the training frames of the seen optical axes minus the labels' visual
/// ones. `radius`: of eyeballs whose size was not measured, canonical units. Finds nothing without
/// eye masks or measured centres.
FoundKappa find_kappa(const Capture& capture, double radius);

} // namespace rye::trainer
