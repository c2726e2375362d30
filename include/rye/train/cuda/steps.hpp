// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/steps.hpp: inputs and results of DeviceAvatarTrainer without its kernels, for
/// units that are not compiled for a device.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <rye/geometry/camera.hpp>
#include <rye/train/augment.hpp>
#include <rye/train/avatar_trainer.hpp>

namespace rye {

/// Photograph of a frame with its masks, in bytes with 255 for 1, pixel (x, y) at index y width +
/// x. Sides are multiples of the factor between picture and render.
struct TrainingView {
    Pinhole<float> camera;             ///< of the render
    Index frame = -1;                  ///< column of delta_pose; -1 for none
    SeenBy<float> view;                ///< column of delta_view, if an avatar has it
    int width = 0, height = 0;         ///< [px]
    std::vector<std::uint8_t> rgb;     ///< 3 per pixel, over black
    std::vector<std::uint8_t> mask;    ///< the subject
    std::vector<std::uint8_t> visible; ///< 0 for padding
    std::vector<std::uint8_t> eyes;    ///< both eyes
};

/// Draw of a step of stage 2.
struct StepDraw {
    Index view = 0;
    bool eyes_high = true;        ///< true if the step takes the high-resolution eye term
    bool scaled = false;          ///< true if super-resolution sees a resized render
    detail::Resizing scale{};     ///< that resizing
    std::array<float, 3> blank{}; ///< background of the face alone
    double rate = 1;              ///< factor of the learning rates
};

/// Device memory of a training, by purpose [bytes].
struct DeviceStepsMemory {
    std::size_t parameters = 0; ///< with gradients, moments and what counts the steps
    std::size_t pictures = 0;   ///< of all views that stay on the device
    std::size_t networks = 0;   ///< of the driven avatar, with its cloud and what its vjp reads
    std::size_t renders = 0;    ///< with the pictures of a step
    std::size_t upsampler = 0;  ///< with what its vjp reads
    std::size_t losses = 0;

    std::size_t sum() const {
        return parameters + pictures + networks + renders + upsampler + losses;
    }
};

/// Result of a run of steps.
struct DeviceStepsReport {
    AvatarLosses<float> losses; ///< of the last step
    Index steps = 0;            ///< taken since the trainer was made, including refused ones
    Index refused_in_a_row = 0; ///< for a gradient that is not finite; such steps change nothing
    std::string bad_field;      ///< field of the last step's bad gradient, if it was refused
    bool asked = false;         ///< true if a rank asked all of them to stop
};

} // namespace rye
