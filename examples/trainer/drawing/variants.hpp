// SPDX-License-Identifier: Apache-2.0
/// drawing/variants.hpp: pictures of a trained run, drawn by the smallest compiled variant of its
/// avatar (variant_list.hpp) with the effects that they need.
#pragma once

#include <optional>
#include <string>

#include "drawing/avatar_drawer.hpp"
#include "drawing/scene_facts.hpp"
#include "drawing/variant_driver.hpp"

namespace rye::trainer {

/// Returns why a device cannot draw what the user asked for by `option`, as FrameDrawer takes it: a
/// device leaves no effects out. Empty if nothing is left out, or nothing was asked for.
std::string left_out_on_device(const std::string& wanted, const std::string& option);

/// Drawer of a run's frames; must not outlive the run.
class FrameDrawer {
  public:
    /// Draws on a device, with all effects of the run.
    explicit FrameDrawer(AvatarDrawer on_device);
    /// Draws with the effects of `wanted`, the value of the user's option `option`: a variant's
    /// name, or names of effects; if it is empty or "auto", the effects that `frames` need so that
    /// no colour changes by more than `bound`. Effects that the variant lacks are held as in the
    /// first frame.
    FrameDrawer(const TrainState& state, const std::vector<DrawnFrame>& frames,
                const std::string& wanted, const std::string& option, double bound);

    Image<float> picture(const DrawnFrame& frame) const;
    /// Returns the picture with all effects of the avatar.
    Image<float> picture_by_all(const DrawnFrame& frame) const;
    /// Returns lines that name the variant and the reasons for it.
    const std::string& explanation() const { return explanation_; }
    const std::string& variant() const { return variant_; }

  private:
    const TrainState* state_;
    std::optional<AvatarDrawer> on_device_;
    std::string variant_, explanation_;
    FrameDriver driver_;
};

} // namespace rye::trainer
