// SPDX-License-Identifier: Apache-2.0
/// training/device_memory.hpp: how much device memory stage 2 needs, before it begins, by formula.
/// CUDA's own memory (its context, code of kernels) is not in it.
#pragma once

#include <array>
#include <string>

#include "training/device.hpp"
#include "training/run.hpp"

namespace rye::trainer {

/// Numbers that the memory follows from, beside the configuration.
struct DeviceSizes {
    double face = 0, eyes = 0;         ///< Gaussians; of the face the most that there can be
    std::array<double, 4> listed = {}; ///< points that expression, pose and both gazes move
    double frames = 0, views = 0;      ///< of training
    int width = 0, height = 0;         ///< of the pictures [px]
    bool lpips = false;                ///< whether the perceptual loss has weights
};

/// Of a run: counted in stage 2; before it estimated, as the face's Gaussians depend on the surface
/// that stage 1 finds.
DeviceSizes device_sizes(const TrainState& state, const Capture& capture);

/// Device memory of stage 2 by what it is for [bytes].
struct DeviceNeed {
    struct Part {
        const char* name;
        double bytes;
        const char* lower; ///< fields that make it less
    };
    std::array<Part, 6> parts;

    double sum() const;
    const Part& largest() const;
};
DeviceNeed device_need(const TrainConfig& config, const DeviceSizes& sizes);

/// "1.9 GB of device memory: parameters 0.1, ...".
std::string text_of(const DeviceNeed& need);

/// Error, beginning with `who` and ending with `rest`, if it is more than the device has free.
void require_device_room(const DeviceNeed& need, const DeviceFacts& device, const std::string& who,
                         const std::string& rest = "");

} // namespace rye::trainer
