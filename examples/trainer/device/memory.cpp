// SPDX-License-Identifier: Apache-2.0
#include "device/memory.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace rye::trainer {
namespace {

/// Places of rye::ViewRing; share of the free memory that is filled with pictures.
constexpr double places_of_fetched = 3, spared = 0.95;

std::string gigabytes(double bytes) {
    char digits[64];
    std::snprintf(digits, sizeof digits, "%.3f", bytes / 1e9);
    return digits;
}

} // namespace

DeviceNeed need_of(const DeviceStepsMemory& memory, const TrainConfig& config, bool lpips) {
    const bool dense = config.gaussians.density.every > 0;
    const auto bytes = [](std::size_t n) { return static_cast<double>(n); };
    return {{{{"parameters, gradient and moments", bytes(memory.parameters),
               dense ? "avatar.networks, gaussians.density.most or gaussians.spacing"
                     : "avatar.networks, gaussians.spacing or gaussians.mouth_points"},
              {"pictures", bytes(memory.pictures),
               "the capture's number or size of pictures, as no field does it"},
              {"networks", bytes(memory.networks),
               dense ? "avatar.networks, gaussians.planes or gaussians.density.most"
                     : "avatar.networks, gaussians.planes or gaussians.mouth_points"},
              {"renders", bytes(memory.renders),
               dense ? "gaussians.density.most or avatar.channels"
                     : "gaussians.mouth_points or avatar.channels"},
              {"upsampler", bytes(memory.upsampler), "gaussians.upsampler.capacity"},
              {"losses", bytes(memory.losses),
               lpips ? "the perceptual loss, by leaving out --perceptual-weights"
                     : "gaussians.weights.dssim to 0"}}}};
}

double DeviceNeed::sum() const {
    double all = 0;
    for (const Part& p : parts) all += p.bytes;
    return all;
}
const DeviceNeed::Part& DeviceNeed::largest() const {
    return *std::max_element(parts.begin(), parts.end(),
                             [](const Part& a, const Part& b) { return a.bytes < b.bytes; });
}

std::string text_of(const DeviceNeed& need) {
    std::string text = "about " + gigabytes(need.sum()) + " GB of device memory:";
    for (const auto& p : need.parts)
        text +=
            std::string(&p == need.parts.data() ? " " : ", ") + p.name + " " + gigabytes(p.bytes);
    if (need.on_host > 0)
        text += "; " + std::to_string(need.on_host) + " of " + std::to_string(need.views) +
                " pictures stay in the host's memory";
    return text;
}

Index views_on_host(const DeviceNeed& need, const DeviceFacts& device) {
    if (need.sum() <= device.free) return 0;
    const double all = need.pictures().bytes, one = all / static_cast<double>(need.views);
    const double others = need.sum() - all + one * places_of_fetched;
    if (others > device.free) return 0;
    const double fit = std::max(0.0, std::floor((spared * device.free - others) / one));
    return need.views - static_cast<Index>(fit);
}

void require_device_room(const DeviceNeed& need, const DeviceFacts& device, const std::string& who,
                         const std::string& rest) {
    require(need.sum() <= device.free, who,
            "got settings that need " + text_of(need) + ", expected at most the " +
                gigabytes(device.free) + " GB that are free of the " + gigabytes(device.total) +
                " GB of " + device.name + "; what needs most is made less by lowering " +
                need.largest().lower + ", or train with --device cpu" + rest);
}

} // namespace rye::trainer
