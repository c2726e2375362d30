// SPDX-License-Identifier: Apache-2.0
/// corrections/centre_errors.hpp: errors of the eyeballs' centres of a run against those that its
/// capture measured, with the eye offset D_e and without.
#pragma once

#include <vector>

#include <nlohmann/json.hpp>

#include "data/capture.hpp"
#include "model/run.hpp"

namespace rye::trainer {

/// Length of a canonical unit [mm]: heads of captures are about 2 units high.
inline constexpr double mm_per_unit = 100;

/// Mean distances of centres from the measured ones [mm], over eyes and frames with a measured one.
struct CentreErrors {
    int eyes = 0;               ///< number of measured centres
    double with = 0;            ///< error of the neutral centre plus D_e of the frame's drivers
    double without = 0;         ///< error of the neutral centre
    /// The same after subtraction of each eye's mean difference: the error of the motion, also if
    /// the neutral centre was not measured but derived from landmarks.
    double motion_with = 0, motion_without = 0;

    nlohmann::ordered_json json() const;
};

/// Returns the errors for a drawn state (run.hpp).
CentreErrors centre_errors(const TrainState& state, const Capture& capture,
                           const std::vector<int>& frames);

} // namespace rye::trainer
