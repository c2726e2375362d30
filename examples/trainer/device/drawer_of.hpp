// SPDX-License-Identifier: Apache-2.0
/// device/drawer_of.hpp: DeviceDrawer by rye::DeviceAvatarDrawer, and DeviceLabels by
/// rye::DeviceLabelDrawing, on any device that runs their kernels: CUDA (engine.hpp), or the
/// emulation of the tests.
#pragma once

#include <rye/avatar/cuda/drawer.hpp>
#include <rye/avatar/hold.hpp>
#include <rye/loss/cuda/lpips.hpp>
#include <rye/train/cuda/label_drawing.hpp>

#include "device/device.hpp"
#include "device/parts.hpp"

namespace rye::trainer {

/// DeviceDrawer on a Machine: a Device, its stream() and its memory, which outlive the work, and
/// its Policy<N> of N planes, whose kernels a DeviceEngineOf shares.
template <EffectSet E, class Machine>
class DeviceDrawerOf final : public DeviceDrawer {
    using Device = typename Machine::Device;
    using Policy = typename Machine::template Policy<drawing_planes>;

  public:
    DeviceDrawerOf(const TwoStream<float, E>& avatar, const AvatarConfig& config,
                   const LandmarkRoles& roles, const std::optional<LpipsWeights<float>>& lpips)
        : queue_{machine_.stream(), machine_.memory},
          drawer_(Device{}, queue_, {avatar, config, roles}) {
        if (lpips) lpips_ = std::make_unique<Lpips>(Device{}, queue_, *lpips);
    }

    void drive(const Drivers<float, TrainEffects>& drivers,
               const Pinhole<float>& camera) override {
        drawer_.drive(queue_, seen_from(restricted<E>(drivers), camera));
    }
    void set_dilation(double dilation) override { drawer_.set_dilation(dilation); }
    Image<float> picture(const Pinhole<float>& camera) override {
        return drawer_.picture(queue_, camera);
    }
    Image<float> eyes(const Pinhole<float>& camera) override {
        return drawer_.eyes(queue_, camera);
    }
    double lpips(const Image<float>& shown, const Image<float>& truth) override {
        require(lpips_ != nullptr, "DeviceDrawer", "weights of LPIPS were not given");
        return lpips_->value(queue_, sent(shown, pictures_[0]), sent(truth, pictures_[1]));
    }
    double bytes() const override {
        return static_cast<double>(drawer_.bytes() + (lpips_ ? lpips_->bytes() : 0) +
                                   pictures_[0].bytes() + pictures_[1].bytes());
    }

  private:
    using Lpips = DeviceLpips<Device, drawing_planes>;

    DevicePicture<const float> sent(const Image<float>& image, DeviceBuffer<float>& to) const {
        to.reserve(queue_, static_cast<std::size_t>(image.pixels.size()));
        Device{}.send(queue_, to.data(), image.pixels.data(),
                      static_cast<std::size_t>(image.pixels.size()) * sizeof(float));
        return {{to.data(), image.channels(), image.size()}, image.width, image.height};
    }

    Machine machine_; // destroyed last: memory is returned on its stream
    CudaQueue queue_;
    DeviceAvatarDrawer<E, Device, Policy> drawer_;
    std::unique_ptr<Lpips> lpips_;
    DeviceBuffer<float> pictures_[2];
};

/// DeviceLabels on a Machine, as DeviceDrawerOf.
template <class Machine>
class DeviceLabelsOf final : public DeviceLabels {
    using Device = typename Machine::Device;
    using Policy = typename Machine::template Policy<drawing_planes>;

  public:
    DeviceLabelsOf(const Avatar& avatar, const AvatarConfig& config, const LandmarkRoles& roles)
        : drawing_(Device{}, {machine_.stream(), machine_.memory}, {avatar, config, roles}) {}

    void drive(const Labels& labels) override { drawing_.drive(labels); }
    void differentiate(const Labels& labels, const std::vector<Labels>& moved,
                       double apart) override {
        drawing_.differentiate(labels, moved, apart);
    }
    const Columns<float>& picture(const LabelView<float>& view) override {
        return drawing_.picture(view);
    }
    Columns<float> jacobian(const LabelView<float>& view,
                            const std::vector<Index>& pixels) override {
        return drawing_.jacobian(view, pixels);
    }
    Columns<double> sums(const LabelView<float>& view, const WeighedColours& colours) override {
        return drawing_.sums(view, colours);
    }
    Index expression_width() const override { return drawing_.expression_width(); }
    void set_dilation(double dilation) override { drawing_.set_dilation(dilation); }

  private:
    Machine machine_; // destroyed last: memory is returned on its stream
    DeviceLabelDrawing<TrainEffects, Device, Policy> drawing_;
};

} // namespace rye::trainer
