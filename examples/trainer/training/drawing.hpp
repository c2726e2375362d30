// SPDX-License-Identifier: Apache-2.0
/// training/drawing.hpp: pictures of a trained run by all that it has, on a device or the CPU, as
/// --device asks for.
#pragma once

#include <memory>
#include <string>

#include "training/device_choice.hpp"
#include "training/steps.hpp"

namespace rye::trainer {

/// Draws frames of a run that is drawn (run.hpp), which it and its copies must not outlive. It may
/// be used by several threads: on a device one at a time, by the CPU side by side.
class AvatarDrawer {
  public:
    /// On the CPU.
    AvatarDrawer(const TrainState& state) : state_(&state) {}
    /// A device as of `decided` (device_choice.hpp), with room for what draws; the CPU where the
    /// choice is automatic and there is none. `perceptual_weights`: a safetensors file for LPIPS,
    /// or empty. Throws Error, beginning with --device, where `wish` asks for a device in vain.
    AvatarDrawer(const TrainState& state, DeviceWish wish,
                 const std::filesystem::path& perceptual_weights = {});

    const TrainState& state() const { return *state_; }
    bool on_device() const { return device_ != nullptr; }
    /// Name of the device that draws, or "cpu".
    std::string name() const;
    /// A line about it: that a device draws, or why the CPU does where a build with kernels has it
    /// by itself; else empty.
    const std::string& words() const { return words_; }

    /// Picture like render_avatar's `high`; `camera` is of the full-size image.
    Image<float> picture(const Drivers<float>& drivers, const Pinhole<float>& camera) const;
    /// Picture like shown_avatar's.
    ShownAvatar shown(const Drivers<float>& drivers, const Pinhole<float>& camera) const;
    /// LPIPS where the drawer draws; empty without weights.
    const PictureDistance& lpips() const { return lpips_; }

  private:
    struct OnDevice;
    const TrainState* state_;
    std::shared_ptr<OnDevice> device_; ///< null: the CPU
    PictureDistance lpips_;
    std::string words_;
};

} // namespace rye::trainer
