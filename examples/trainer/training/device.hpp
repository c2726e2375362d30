// SPDX-License-Identifier: Apache-2.0
/// training/device.hpp: the CUDA device of this machine, and stage 2 on it, without CUDA's types.
/// A build with -DRYE_CUDA=ON has sources of nvcc behind it (device*.cu), any other no_device.cpp.
/// Types of Eigen cross between units of two compilers: their alignment is in the symbols' names,
/// so that units that differ in it do not link.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <rye/loss/lpips.hpp>
#include <rye/nn/adam.hpp>
#include <rye/train/avatar_trainer.hpp>

#include "training/effects.hpp"

namespace rye::trainer {

/// The device that a run would have.
struct DeviceFacts {
    std::string name;
    double free = 0, total = 0; ///< memory [bytes]
};

/// What is known of devices here.
struct DeviceFinding {
    bool built = false;               ///< whether this build has kernels
    std::optional<DeviceFacts> found; ///< the device that is current
    std::string reason;               ///< why there is none
};
DeviceFinding find_device();

/// A photograph of a frame with its masks, in bytes: shares of 255, pixel (x, y) in place
/// y width + x. Sides are multiples of the upsampler's factor.
struct DeviceView {
    Pinhole<float> camera;                              ///< of the render
    Index frame = -1;                                   ///< column of delta_pose; -1: none
    int width = 0, height = 0;                          ///< [px]
    std::vector<std::uint8_t> rgb, mask, visible, eyes; ///< 3 a pixel over black; 1, 1, 1
    Drivers<float> drivers;                             ///< of its frame
};

/// What a step on a device is shown; `view` is a number that add() gave.
struct DeviceDraw {
    Index view = 0;
    bool eyes_high = true, scaled = false;
    detail::Resizing scale{};
    std::array<float, 3> blank{};
    double rate = 1;
};

/// What steps on a device have come to.
struct DeviceReport {
    AvatarLosses<float> losses; ///< of the last one
    Index refused = 0;          ///< in a row, the last ones: a gradient was not finite
    std::string bad_field;      ///< whose
};

/// What a device is told beside the avatar.
struct DeviceTask {
    AvatarTraining<Balanced, PyramidGradientLoss> training; ///< its perceptual loss is not read
    std::optional<LpipsWeights<float>> lpips;               ///< else the loss without weights
    int planes = 1; ///< of bf16 a float of the networks' products
};

/// Stage 2 of one avatar on a device, which has its own copy of avatar and optimiser.
template <EffectSet E>
class DeviceEngine {
  public:
    virtual ~DeviceEngine() = default;
    /// Takes a view, which stays on the device; returns its number.
    virtual Index add(const DeviceView& view) = 0;
    /// Takes the steps of these draws in their order, and waits.
    virtual DeviceReport run(const std::vector<DeviceDraw>& draws) = 0;
    /// The avatar and its optimiser as they are now.
    virtual void fetch(TwoStream<float, E>& avatar, Adam<TwoStream<float, E>>& adam) const = 0;
    virtual double bytes() const = 0; ///< that are held
};

/// Stage 2 on the current device, for each avatar of effects.hpp. Throws Error for what does not
/// fit, and in a build without kernels.
template <EffectSet E, int alignment = EIGEN_MAX_ALIGN_BYTES>
std::unique_ptr<DeviceEngine<E>> device_engine(const TwoStream<float, E>& avatar,
                                               const Adam<TwoStream<float, E>>& adam,
                                               const DeviceTask& task);

/// The same of N planes, 1 or 3.
template <EffectSet E, int N, int alignment = EIGEN_MAX_ALIGN_BYTES>
std::unique_ptr<DeviceEngine<E>> device_engine_of(const TwoStream<float, E>& avatar,
                                                  const Adam<TwoStream<float, E>>& adam,
                                                  const DeviceTask& task);

} // namespace rye::trainer
