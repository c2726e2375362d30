// SPDX-License-Identifier: Apache-2.0
/// corrections/expression_regions.hpp: regions of the face on which the coefficients of an expression
/// act, by their names. Source: descendants of the facial action coding system (ARKit, ICT-FaceKit:
/// browDown_L, jawOpen, mouthSmileRight), whose names begin with the region and end with the side.
#pragma once

#include <string>
#include <vector>

#include <rye/core/columns.hpp>
#include <rye/train/landmark_regression.hpp>

#include "data/config.hpp"
#include "data/samples.hpp"

namespace rye::trainer {

/// Returns limits on the motion of each landmark by each coefficient, E x L in (0, 1]
/// (RegressionConfig::expression_reach): 1 near the landmarks of its region, falling to a twentieth
/// over half the distance of the eyes; 1 everywhere for a name without a region; empty if no name
/// has one. landmarks: 3 x L, of which the first 66 are iBUG's without 48 and 54; canonical.
Columns<double> expression_reach(const std::vector<std::string>& names,
                                 const Columns<double>& landmarks);

/// Returns the prior of expressions that a capture does not show, by the names and shapes of its
/// coefficients, as mesh.fit_regions and fit_shapes say. Throws an Error as expression_shapes does.
RegressionConfig expression_prior(const Capture& capture, const Subject& subject,
                                  const MeshTrainConfig& config);

} // namespace rye::trainer
