// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/trainer_policy.hpp: compile-time choices of DeviceAvatarTrainer, and its signals
/// to a device.
#pragma once

#include <rye/avatar/cuda/field.hpp>
#include <rye/splat/cuda/rasterizer.hpp>

namespace rye {

/// Choices of a trainer: planes and widths of the networks' products, numbers of channels that
/// renders have kernels for, accuracy of renders.
template <class Networks_ = DeviceNetworks<1>, class Channels_ = KernelChannels<3, 32>,
          DeviceAccuracy A = Balanced, int upsampler_planes_ = 1>
struct DeviceTrainerPolicy {
    using Networks = Networks_;
    using Channels = Channels_;
    using Accuracy = FeaturesOnly<A>;
    static constexpr int upsampler_planes = upsampler_planes_;
};

/// A device that is told where the parts of a step end on the stream, as in train/probe.hpp.
template <class D>
concept ProbedDevice = requires(const D& device, const CudaQueue& queue, const char* part) {
    device.probe(queue, part);
};

} // namespace rye
