// SPDX-License-Identifier: Apache-2.0
/// device/memory.hpp: estimate by formula, before it begins, of the device memory that
/// stage 2 needs, without CUDA's own memory (its context, code of kernels).
#pragma once

#include <array>
#include <string>

#include "device/device.hpp"
#include "model/ranks.hpp"
#include "model/run.hpp"

namespace rye::trainer {

/// Sizes that determine the memory, beside the configuration.
struct DeviceSizes {
    double face = 0, eyes = 0;         ///< number of Gaussians; of the face, the largest possible
    std::array<double, 4> listed = {}; ///< points moved by expression, pose and both gazes
    double frames = 0, views = 0;      ///< for training
    int width = 0, height = 0;         ///< of the pictures [px]
    bool lpips = false;                ///< true if the perceptual loss has weights
    double on_host = 0;                ///< of the views, those that stay in the host's memory
    int gradients = 0; ///< further ones, for sums over pictures of a step and over ranks
};

/// Returns the sizes of a run: counted in stage 2, estimated before, as the number of the face's
/// Gaussians depends on the surface that stage 1 finds.
DeviceSizes device_sizes(const TrainState& state, const Capture& capture);

/// Device memory of stage 2, by purpose [bytes].
struct DeviceNeed {
    struct Part {
        const char* name;
        double bytes;
        const char* lower; ///< fields that reduce it
    };
    std::array<Part, 6> parts;

    double sum() const;
    const Part& largest() const;
};
/// Returns the gradients that sums over pictures of a step and over ranks (null: one) hold.
int gradients_of(const TrainConfig& config, const Ranks* ranks);
DeviceNeed device_need(const TrainConfig& config, const DeviceSizes& sizes);

/// Returns a text such as "1.9 GB of device memory: parameters 0.1, ...".
std::string text_of(const DeviceNeed& need);

/// Returns the number of views that must stay in the host's memory for the rest to fit a device;
/// 0 if all fit, or if it is not the pictures that do not.
double views_on_host(const TrainConfig& config, const DeviceSizes& sizes,
                     const DeviceFacts& device);
/// Returns the memory of a picture with its masks and drivers [bytes].
double picture_bytes(const TrainConfig& config, const DeviceSizes& sizes);

/// Returns "; N of M pictures stay in the host's memory", or nothing if none does.
std::string text_of_pictures(const DeviceSizes& sizes);

/// Throws an Error that begins with `who` and ends with `rest` if more is needed than the device
/// has free.
void require_device_room(const DeviceNeed& need, const DeviceFacts& device, const std::string& who,
                         const std::string& rest = "");

} // namespace rye::trainer
