// SPDX-License-Identifier: Apache-2.0
/// evaluation/head_alignment.hpp: the rigid motion between the head frame of a run and that of a
/// capture. Head poses that were off alike in all training frames turn and shift the head frame of
/// the run, which no training frame can tell. `rye evaluate --align-head` takes that motion out of
/// the head poses that it draws by, and so measures what else is wrong.
#pragma once

#include <vector>

#include <nlohmann/json.hpp>

#include <rye/geometry/rigid.hpp>

#include "data/capture.hpp"
#include "model/run.hpp"

namespace rye::trainer {

struct HeadAlignment {
    Rigid<double> capture_from_run;      ///< of head frames [canonical units]
    double before_mm = 0, after_mm = 0;  ///< distance of landmarks without and with it, rms [mm]

    double turn_degrees() const;  ///< Returns the angle of the rotation.
    double shift_mm() const;      ///< Returns the length of the translation.
    nlohmann::ordered_json json() const;
};

/// Returns the motion by which the landmarks of the run's first stage, deformed by the expressions
/// and gazes of these frames, are nearest to the frames' own. The state has its mesh.
HeadAlignment head_alignment(const TrainState& state, const Capture& capture,
                             const std::vector<int>& frames);

/// Replaces head poses and gazes of all frames by those in the head frame of the run. In the world
/// the gazes stay.
void take_head_frame(Capture& capture, const Rigid<double>& capture_from_run);

} // namespace rye::trainer
