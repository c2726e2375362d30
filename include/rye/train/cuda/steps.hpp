// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/steps.hpp: what DeviceAvatarTrainer is given and gives back, without its kernels:
/// for units that no device compiler sees.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include <rye/geometry/camera.hpp>
#include <rye/train/augment.hpp>
#include <rye/train/avatar_trainer.hpp>

namespace rye {

/// A photograph of a frame with its masks, in bytes: shares of 255, pixel (x, y) in place
/// y width + x. Sides are multiples of the factor between picture and render.
struct TrainingView {
    Pinhole<float> camera;             ///< of the render
    Index frame = -1;                  ///< column of delta_pose; -1: none
    int width = 0, height = 0;         ///< [px]
    std::vector<std::uint8_t> rgb;     ///< 3 a pixel, over black
    std::vector<std::uint8_t> mask;    ///< the subject
    std::vector<std::uint8_t> visible; ///< 0 where the picture was padded
    std::vector<std::uint8_t> eyes;    ///< both eyes
};

/// What a step of stage 2 is shown.
struct StepDraw {
    Index view = 0;
    bool eyes_high = true;        ///< whether it takes the high-resolution eye term
    bool scaled = false;          ///< whether super-resolution sees a resized render ...
    detail::Resizing scale{};     ///< ... by this
    std::array<float, 3> blank{}; ///< background of the face alone
    double rate = 1;              ///< factor of the learning rates
};

/// What steps have come to.
struct DeviceStepsReport {
    AvatarLosses<float> losses; ///< of the last step
    Index steps = 0;            ///< taken since the trainer was made, refused ones included
    Index refused_in_a_row = 0; ///< for a gradient that was not finite; nothing has changed then
    std::string bad_field;      ///< of the last step, if it was refused
};

} // namespace rye
