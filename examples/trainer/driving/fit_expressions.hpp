// SPDX-License-Identifier: Apache-2.0
/// driving/fit_expressions.hpp: coefficients with names, of a face tracker, in terms of an avatar's
/// that have none: what both move in the landmarks, less each one's head at rest.
#pragma once

#include <string>

#include <rye/core/columns.hpp>

#include "data/capture.hpp"
#include "driving/retarget.hpp"
#include "synthetic_capture/head_model.hpp"

namespace rye::trainer {

/// Returns the 66 landmarks of a head model at these weights, lids open, 3 x 66.
Columns<double> landmarks_at(const HeadModel& model, const VecX<double>& weights);

/// Returns the mix for the names of a head model. Landmarks of the capture's frames are a linear
/// function of expression and gaze, by a ridge with the frames' own deviations as a prior; the
/// model's displacements are turned and scaled to its head, and expressed by these. Throws an Error
/// that begins with `who` for fewer than `least_fit_frames` frames, or landmarks that are all
/// alike.
ExpressionMix fitted_mix(const HeadModel& model, const Capture& capture, const std::string& who);

inline constexpr int least_fit_frames = 6;

} // namespace rye::trainer
