// SPDX-License-Identifier: Apache-2.0
/// drawing/avatar_drawer.hpp: pictures of a trained run with all of its effects, on a device or the CPU,
/// as --device asks for.
#pragma once

#include <memory>
#include <string>

#include "device/choice.hpp"
#include "drawing/shown.hpp"
#include "model/perceptual_weights.hpp"

namespace rye::trainer {

/// Drawer of a drawn run's frames (run.hpp). It and its copies must not outlive the run. Several
/// threads may use it: one at a time on a device, in parallel on the CPU.
class AvatarDrawer {
  public:
    /// Draws on the CPU.
    AvatarDrawer(const TrainState& state) : state_(&state) {}
    /// Draws on a device as `decided` (device/choice.hpp) with enough memory, or on the CPU if the
    /// choice is automatic and there is none. `perceptual_weights`: a safetensors file for LPIPS,
    /// or empty. Throws an Error that begins with --device if `wish` asks for a device in vain.
    AvatarDrawer(const TrainState& state, DeviceWish wish,
                 const std::filesystem::path& perceptual_weights = {});

    const TrainState& state() const { return *state_; }
    bool on_device() const { return device_ != nullptr; }
    /// Returns the name of the device that draws, or "cpu".
    std::string name() const;
    /// Returns a line: that a device draws, or why the CPU does if a build with kernels chose it by
    /// itself; else empty.
    const std::string& words() const { return words_; }

    /// Returns a picture like render_avatar's `high`.
    Image<float> picture(const DrawnFrame& frame) const;
    /// Returns a picture like shown_avatar's.
    ShownAvatar shown(const DrawnFrame& frame) const;
    /// Returns LPIPS on the drawer's side (device or CPU); empty without weights.
    const PictureDistance& lpips() const { return lpips_; }

  private:
    struct OnDevice;
    const TrainState* state_;
    std::shared_ptr<OnDevice> device_; ///< null for the CPU
    PictureDistance lpips_;
    std::string words_;
};

} // namespace rye::trainer
