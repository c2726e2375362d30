// SPDX-License-Identifier: Apache-2.0
/// training/device.hpp: the CUDA device of this machine, and stage 2 and pictures on it, without
/// CUDA's types.
/// A build with -DRYE_CUDA=ON has sources of nvcc behind it (device*.cu), any other no_device.cpp.
/// Types of Eigen cross between units of two compilers: their alignment is in the symbols' names,
/// so that units that differ in it do not link.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <rye/loss/lpips.hpp>
#include <rye/nn/adam.hpp>
#include <rye/train/cuda/steps.hpp>

#include "training/effects.hpp"

namespace rye::trainer {

/// The device that a run would have.
struct DeviceFacts {
    std::string name;
    double free = 0, total = 0; ///< memory [bytes]
};

/// The device that was found, or the reason why there is none.
struct DeviceFinding {
    bool built = false;               ///< whether this build has kernels
    std::optional<DeviceFacts> found; ///< the device that is current
    std::string reason;               ///< why there is none
};
DeviceFinding find_device();
/// True if this build has kernels; does not look for a device.
bool has_device_kernels();

/// Settings of a training on a device, beside the avatar.
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
    /// Takes a view and what drives its frame, which stay on the device; returns its number.
    virtual Index add(const TrainingView& view, const Drivers<float>& drivers) = 0;
    /// Takes the steps of these draws in their order, and waits.
    virtual DeviceStepsReport run(const std::vector<StepDraw>& draws) = 0;
    /// The avatar and its optimiser as they are now, into structs of the same shapes.
    virtual void fetch(TwoStream<float, E>& avatar, Adam<TwoStream<float, E>>& adam) const = 0;
    /// Goes on from these, whose face may have another number of Gaussians; views stay.
    virtual void restart(const TwoStream<float, E>& avatar,
                         const Adam<TwoStream<float, E>>& adam) = 0;
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

/// Planes of bf16 a float of the networks' products of pictures that are drawn on a device,
/// whatever the run was trained with: pictures agree with the CPU's to about 1e-5, for a
/// millisecond a frame.
inline constexpr int drawing_planes = 3;

/// Draws one avatar on a device, for one thread at a time. All of it waits.
class DeviceDrawer {
  public:
    virtual ~DeviceDrawer() = default;
    /// Drives the avatar for the pictures that follow; gazes are what drives this avatar. Frames
    /// that differ in the gazes alone from the one before take less time, and have the same bits.
    virtual void drive(const Drivers<float>& drivers) = 0;
    /// After super-resolution, on white; `camera` is that of the render.
    virtual Image<float> picture(const Pinhole<float>& camera) = 0;
    /// Each eye's share of the pixels' colours, two channels.
    virtual Image<float> eyes(const Pinhole<float>& camera) = 0;
    /// LPIPS of two pictures, of a drawer that was given its weights.
    virtual double lpips(const Image<float>& shown, const Image<float>& truth) = 0;
    virtual double bytes() const = 0; ///< that are held
};

/// A drawer on the current device, for each avatar that pictures of runs are drawn with: of
/// TrainEffects and ComparedEffects. Throws Error for what does not fit, and in
/// a build without kernels.
template <EffectSet E, int alignment = EIGEN_MAX_ALIGN_BYTES>
std::unique_ptr<DeviceDrawer> device_drawer(const TwoStream<float, E>& avatar,
                                            const AvatarConfig& config, const LandmarkRoles& roles,
                                            const std::optional<LpipsWeights<float>>& lpips);

} // namespace rye::trainer
