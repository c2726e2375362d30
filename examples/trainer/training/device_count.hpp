// SPDX-License-Identifier: Apache-2.0
/// training/device_count.hpp: the device memory that stage 2 needs, counted before it begins: its
/// engine is made and run by an idle task, of an avatar of as many Gaussians.
#pragma once

#include <cstdint>
#include <vector>

#include "device/memory.hpp"
#include "training/device_steps.hpp"

namespace rye::trainer {

/// Sizes that determine the memory, beside the configuration.
struct DeviceSizes {
    Index face = 0, eyes = 0;          ///< number of Gaussians; of the face, the largest possible
    std::vector<std::uint32_t> listed; ///< points moved by expression, pose and both gazes
    Index views = 0;                   ///< for training
    int width = 0, height = 0;         ///< of the pictures [px]
};

/// Returns the sizes of a run: counted in stage 2, estimated before, as the number of the face's
/// Gaussians depends on the surface that stage 1 finds.
DeviceSizes device_sizes(const TrainState& state, const Capture& capture);

/// Returns a state of stage 2 with so many Gaussians: those of a state in stage 2 with zeros for a
/// face of another number, and of one in stage 1 zeros alone. It has no mesh and no moments.
TrainState sized_state(const TrainState& state, const DeviceSizes& sizes);

/// Returns the need of a run on a device by kernels of this build, and tells `settings` which views
/// stay in the host's memory because the device has no room for all. lpips: true if the perceptual
/// loss has weights. Throws an Error in a build without kernels.
DeviceNeed device_need(const TrainState& state, const Capture& capture, bool lpips,
                       const DeviceFacts& device, DeviceStepSettings& settings);

} // namespace rye::trainer
