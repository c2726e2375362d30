// SPDX-License-Identifier: Apache-2.0
/// training/expression_regions.hpp: where on the face the coefficients of an expression act, by
/// their names. Source: names of the facial action coding system's descendants (ARKit, ICT-FaceKit:
/// browDown_L, jawOpen, mouthSmileRight), which begin with the region and end with the side.
#pragma once

#include <string>
#include <vector>

#include <rye/core/columns.hpp>
#include <rye/train/landmark_regression.hpp>

#include "data/config.hpp"
#include "data/samples.hpp"

namespace rye::trainer {

/// Limits on what each coefficient moves of each landmark, E x L in (0, 1]
/// (RegressionConfig::expression_reach): 1 near the landmarks of its region, falling off to a
/// twentieth over half the distance of the eyes; 1 everywhere for a name that tells no region.
/// Empty where no name does. landmarks: 3 x L, of which the first 66 are iBUG's without 48 and 54;
/// canonical.
Columns<double> expression_reach(const std::vector<std::string>& names,
                                 const Columns<double>& landmarks);

/// Knowledge of frames that a capture has not, by the names and shapes of its expressions, as
/// mesh.fit_regions and fit_shapes say. Throws Error as expression_shapes does.
RegressionConfig expression_prior(const Capture& capture, const Subject& subject,
                                  const MeshTrainConfig& config);

} // namespace rye::trainer
