// SPDX-License-Identifier: Apache-2.0
/// training/device_steps.hpp: stage 2 of a run on a device: all training views resident, steps in
/// chunks, the state's avatar and optimiser fetched where something reads them.
#pragma once

#include <memory>
#include <vector>

#include "training/device.hpp"
#include "training/draws.hpp"
#include "training/steps.hpp"

namespace rye::trainer {

/// A view of a capture in bytes, extended as avatar_sample extends it.
TrainingView training_view(const Capture& capture, const TrainConfig& config, int frame,
                           int camera);

/// AvatarSteps on a device.
class DeviceSteps {
  public:
    virtual ~DeviceSteps() = default;
    /// Takes the steps of these draws, which follow state.step, and adds their number to it. The
    /// report is of the last one.
    virtual StepReport run(TrainState& state, const std::vector<SampleDraw>& draws) = 0;
    /// Avatar and optimiser, into the state.
    virtual void fetch(TrainState& state) const = 0;
    /// Goes on from the state's, whose face may have another number of Gaussians.
    virtual void restart(const TrainState& state) = 0;
    virtual double bytes() const = 0; ///< of device memory that are held
};

/// Takes the state's avatar and optimiser and the capture's training views to the device. The state
/// is one of stage 2 that without_kernels (device_choice.hpp) finds nothing in.
std::unique_ptr<DeviceSteps> device_steps(const TrainState& state, const Capture& capture,
                                          const std::filesystem::path& perceptual_weights);

/// The number of steps taken after the next chunk: the next multiple of `log_every`, of the run's
/// panel_every or of its checkpoint_every, the next step that a change of density follows, or
/// `total`.
Index chunk_end(Index step, Index total, Index log_every, const AvatarTrainConfig& config);

} // namespace rye::trainer
