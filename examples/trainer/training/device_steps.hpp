// SPDX-License-Identifier: Apache-2.0
/// training/device_steps.hpp: stage 2 of a run on a device: all training views resident, steps in
/// chunks, the state's avatar and optimiser fetched on demand.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "device/device.hpp"
#include "model/draws.hpp"
#include "training/steps.hpp"

namespace rye::trainer {

/// Returns a view of a capture in bytes, extended as avatar_sample extends it.
TrainingView training_view(const Capture& capture, const TrainConfig& config, int frame,
                           int camera);

/// Steps of stage 2 on a device, as AvatarSteps.
class DeviceSteps {
  public:
    virtual ~DeviceSteps() = default;
    /// Takes the steps of these draws, which follow state.step, and adds their number to it.
    /// Returns the report of the last one. ask: true to ask all ranks to stop.
    virtual StepReport run(TrainState& state, const std::vector<SampleDraw>& draws,
                           bool ask = false) = 0;
    /// Copies avatar and optimiser into the state.
    virtual void fetch(TrainState& state) const = 0;
    /// Continues from the state's avatar, whose face may have another number of Gaussians.
    virtual void restart(const TrainState& state) = 0;
    virtual DeviceStepsMemory memory() const = 0; ///< device memory held
};

/// Settings of steps on a device beside the configuration.
struct DeviceStepSettings {
    Ranks* ranks = nullptr;      ///< null: one
    RankSum by = RankSum::tree;  ///< how ranks add up
    /// Number of views in the device's memory, if the rest stays in the host's.
    std::optional<Index> on_device = {};
};
/// Returns the task of a device that trains the avatar of a state, without LPIPS. neighbours:
/// first_neighbours of the state.
DeviceTask device_task(const TrainState& state, const FaceNeighbours& neighbours,
                       const DeviceStepSettings& settings);

/// Copies the state's avatar and optimiser and the capture's training views to the device. The
/// state must be in stage 2, and without_kernels (device/choice.hpp) empty for it.
std::unique_ptr<DeviceSteps> device_steps(const TrainState& state, const Capture& capture,
                                          const std::filesystem::path& perceptual_weights,
                                          const DeviceStepSettings& settings = {});

constexpr Index log_every = 20; ///< steps between lines of log.jsonl

/// Returns the number of steps after the next chunk: the next multiple of log_every, of the run's
/// panel_every or checkpoint_every, the next step that a change of density follows, or `total`.
Index chunk_end(Index step, Index total, const AvatarTrainConfig& config);

} // namespace rye::trainer
