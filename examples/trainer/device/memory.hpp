// SPDX-License-Identifier: Apache-2.0
/// device/memory.hpp: what is told of the device memory that stage 2 needs, without CUDA's own
/// (its context, code of kernels), and what of it a device has room for.
#pragma once

#include <array>
#include <string>

#include "data/config.hpp"
#include "device/device.hpp"

namespace rye::trainer {

/// Device memory of stage 2, by purpose [bytes].
struct DeviceNeed {
    struct Part {
        const char* name;
        double bytes;
        const char* lower; ///< fields that reduce it
    };
    std::array<Part, 6> parts;
    Index views = 0, on_host = 0; ///< pictures, and those that stay in the host's memory

    const Part& pictures() const { return parts[1]; }
    const Part& largest() const;
    double sum() const;
};
/// Returns the need of a training that holds this memory. config: whose fields reduce it.
DeviceNeed need_of(const DeviceStepsMemory& memory, const TrainConfig& config, bool lpips);

/// Returns a text such as "about 1.9 GB of device memory: parameters 0.1, ...".
std::string text_of(const DeviceNeed& need);

/// Returns the number of views that must stay in the host's memory for the rest to fit a device;
/// 0 if all fit, or if it is not the pictures that do not. need: of all views on the device.
Index views_on_host(const DeviceNeed& need, const DeviceFacts& device);

/// Throws an Error that begins with `who` and ends with `rest` if more is needed than the device
/// has free.
void require_device_room(const DeviceNeed& need, const DeviceFacts& device, const std::string& who,
                         const std::string& rest = "");

} // namespace rye::trainer
