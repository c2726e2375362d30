// SPDX-License-Identifier: Apache-2.0
/// device/device.hpp: the CUDA device of this machine, for stage 2 and for pictures, without
/// CUDA's types. A build with -DRYE_CUDA=ON implements it in sources of nvcc (device*.cu), any
/// other in none.cpp. Types of Eigen are passed between units of two compilers: their
/// alignment is part of the symbols' names, so that units that differ in it do not link.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <rye/loss/lpips.hpp>
#include <rye/nn/adam.hpp>
#include <rye/train/cuda/steps.hpp>
#include <rye/train/group.hpp>
#include <rye/train/label_drawing.hpp>

#include "model/effects.hpp"
#include "model/ranks.hpp"

namespace rye::trainer {

/// Facts about the device that a run would use.
struct DeviceFacts {
    std::string name;
    double free = 0, total = 0; ///< memory [bytes]
};

/// The device found, or the reason why there is none.
struct DeviceFinding {
    bool built = false;               ///< true if this build has kernels
    std::optional<DeviceFacts> found; ///< current device
    std::string reason;               ///< why there is none
};
DeviceFinding find_device();
/// Makes one of the machine's devices current for the calling thread: number `which`, from 0, of
/// those there are. Throws an Error if there are fewer.
void use_device(int which);
/// Returns the number of devices.
int device_count();
/// Returns true if this build has kernels; does not look for a device.
bool has_device_kernels();

/// Settings of a training on a device, beside the avatar.
struct DeviceTask {
    AvatarTraining<Balanced, PyramidGradientLoss> training; ///< its perceptual loss is ignored
    std::optional<LpipsWeights<float>> lpips;               ///< empty: the loss without weights
    int planes = 1; ///< bf16 planes per float in the networks' products
    bool narrow = false; ///< true if the networks fit narrow_tiles (device/choice.hpp)
    StepShare share = {};         ///< pictures of a step that this rank takes
    Ranks* ranks = nullptr;       ///< null: one rank; must outlive the work
    RankSum by = RankSum::tree;   ///< how ranks add up
    std::optional<Index> on_device = {}; ///< views in the device's memory, the rest in the host's
    bool idle = false; ///< true if no memory is taken and nothing is done, to count the memory
    std::vector<std::uint32_t> listed = {}; ///< of an idle task: points that each driver moves
};

/// Stage 2 of one avatar on a device, which has its own copy of avatar and optimiser.
template <EffectSet E>
class DeviceEngine {
  public:
    virtual ~DeviceEngine() = default;
    /// Adds a view and its frame's drivers, which stay on the device; returns its number.
    virtual Index add(const TrainingView& view, const Drivers<float>& drivers) = 0;
    /// Takes the steps of these draws in order, and waits. ask: true to ask all ranks to stop.
    virtual DeviceStepsReport run(const std::vector<StepDraw>& draws, bool ask = false) = 0;
    /// Copies the current avatar and optimiser into structs of the same shapes.
    virtual void fetch(TwoStream<float, E>& avatar, Adam<TwoStream<float, E>>& adam) const = 0;
    /// Continues from this avatar and optimiser, whose face may have another number of Gaussians;
    /// keeps the views.
    virtual void restart(const TwoStream<float, E>& avatar,
                         const Adam<TwoStream<float, E>>& adam) = 0;
    virtual DeviceStepsMemory memory() const = 0; ///< held, or of an idle task what would be
};

/// Returns stage 2 on the current device, for each avatar of effects.hpp. Throws an Error for sizes
/// that do not fit, and in a build without kernels.
template <EffectSet E, int alignment = EIGEN_MAX_ALIGN_BYTES>
std::unique_ptr<DeviceEngine<E>> device_engine(const TwoStream<float, E>& avatar,
                                               const Adam<TwoStream<float, E>>& adam,
                                               const DeviceTask& task);

/// Returns the same for N planes, 1 or 3; with narrow tiles for one plane and TrainEffects alone.
template <EffectSet E, int N, bool narrow, int alignment = EIGEN_MAX_ALIGN_BYTES>
std::unique_ptr<DeviceEngine<E>> device_engine_of(const TwoStream<float, E>& avatar,
                                                  const Adam<TwoStream<float, E>>& adam,
                                                  const DeviceTask& task);

/// Number of bf16 planes per float in the networks' products for pictures drawn on a device, for
/// any run: pictures agree with the CPU's to about 1e-5, for a millisecond per frame.
inline constexpr int drawing_planes = 3;

/// Drawer of one avatar on a device, for one thread at a time. All functions wait.
class DeviceDrawer {
  public:
    virtual ~DeviceDrawer() = default;
    /// Drives the avatar for pictures by this camera, by gazes as this avatar takes them. A frame
    /// that differs from the previous one in gazes and pupils alone takes less time, and has the
    /// same bits.
    virtual void drive(const Drivers<float, TrainEffects>& drivers,
                       const Pinhole<float>& camera) = 0;
    /// Draws with this dilation from now on [px^2].
    virtual void set_dilation(double dilation) = 0;
    /// Returns the picture after super-resolution, on white; `camera` is that of the render.
    virtual Image<float> picture(const Pinhole<float>& camera) = 0;
    /// Returns each eye's share of the pixels' colours, two channels.
    virtual Image<float> eyes(const Pinhole<float>& camera) = 0;
    /// Returns LPIPS of two pictures; the drawer must have been given its weights.
    virtual double lpips(const Image<float>& shown, const Image<float>& truth) = 0;
    virtual double bytes() const = 0; ///< device memory held
};

/// Returns a drawer on the current device, for the avatars of pictures of runs: TrainEffects and
/// ComparedEffects. Throws an Error for sizes that do not fit, and in a build without kernels.
template <EffectSet E, int alignment = EIGEN_MAX_ALIGN_BYTES>
std::unique_ptr<DeviceDrawer> device_drawer(const TwoStream<float, E>& avatar,
                                            const AvatarConfig& config, const LandmarkRoles& roles,
                                            const std::optional<LpipsWeights<float>>& lpips);

/// Drawing of one avatar's labels on a device: a LabelDrawing (rye/train/label_drawing.hpp).
class DeviceLabels {
  public:
    using Number = float;
    using Labels = Drivers<float, TrainEffects>;

    virtual ~DeviceLabels() = default;
    virtual void drive(const Labels& labels) = 0;
    virtual void differentiate(const Labels& labels, const std::vector<Labels>& moved,
                               double apart) = 0;
    virtual const Columns<float>& picture(const LabelView<float>& view) = 0;
    virtual Columns<float> jacobian(const LabelView<float>& view,
                                    const std::vector<Index>& pixels) = 0;
    virtual Columns<double> sums(const LabelView<float>& view, const WeighedColours& colours) = 0;
    virtual Index expression_width() const = 0;
    /// Draws with this dilation from now on [px^2].
    virtual void set_dilation(double dilation) = 0;
};

/// Returns such a drawing on the current device. Throws an Error for sizes that do not fit, and in
/// a build without kernels.
template <EffectSet E, int alignment = EIGEN_MAX_ALIGN_BYTES>
std::unique_ptr<DeviceLabels> device_labels(const TwoStream<float, E>& avatar,
                                            const AvatarConfig& config,
                                            const LandmarkRoles& roles);

} // namespace rye::trainer
