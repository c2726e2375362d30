// SPDX-License-Identifier: Apache-2.0
/// training/variants.hpp: pictures of a trained run, drawn by the smallest compiled variant
/// of its avatar (variant_list.hpp) that has what they call for.
#pragma once

#include <optional>
#include <string>

#include "training/drawing.hpp"
#include "training/scene_facts.hpp"
#include "training/variant_driver.hpp"

namespace rye::trainer {

/// Why a device does not draw what the user asked for by `option`, as FrameDrawer takes it: it
/// leaves no effects out. Empty where nothing is left out, or nothing was asked for.
std::string left_out_on_device(const std::string& wanted, const std::string& option);

/// Draws frames of a run, which it must not outlive.
class FrameDrawer {
  public:
    /// By a drawer on a device, with all that the run has.
    explicit FrameDrawer(AvatarDrawer on_device);
    /// `wanted` is what the user asked for (of the option `option`): a variant's name, or names of
    /// effects; if it is empty or "auto", what `frames` call for so that no colour changes by more than
    /// `bound`. What the variant has not is held as in the first frame.
    FrameDrawer(const TrainState& state, const std::vector<DrawnFrame>& frames,
                const std::string& wanted, const std::string& option, double bound);

    Image<float> picture(const DrawnFrame& frame) const;
    /// As picture, but by all that the avatar has.
    Image<float> picture_by_all(const DrawnFrame& frame) const;
    /// Which variant was taken and why, in lines.
    const std::string& explanation() const { return explanation_; }
    const std::string& variant() const { return variant_; }

  private:
    const TrainState* state_;
    std::optional<AvatarDrawer> on_device_;
    std::string variant_, explanation_;
    FrameDriver driver_;
};

} // namespace rye::trainer
