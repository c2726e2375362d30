// SPDX-License-Identifier: Apache-2.0
/// training/draws.hpp: what a step of stage 2 is shown: a function of (configuration, seed, step)
/// alone. A step on the CPU and one on a device are built from the same draw, and a resumed run
/// goes on with the draws of the interrupted one.
#pragma once

#include <vector>

#include <rye/train/augment.hpp>

#include "data/samples.hpp"

namespace rye::trainer {

/// The frame of a step; the order within an epoch depends on seed and epoch alone.
int frame_of_step(const std::vector<int>& frames, Index step, const Random& random);

/// Cameras that have an image of a frame; Error where none has.
std::vector<int> present_cameras(const Capture& capture, int frame);

/// Share left of a learning rate that falls to `decay` of itself in `total` steps.
double decayed(double decay, Index step, Index total);

/// Steps of a stage: `steps`, or unless they are above 0 `epochs` times the training frames.
Index total_steps(int steps, int epochs, const Capture& capture);

/// Frame, camera, colour and scale that one step of stage 2 is shown.
struct SampleDraw {
    Index step = 0;
    int frame = 0, camera = 0; ///< of the capture
    bool eyes_high = true;     ///< whether the step takes the high-resolution eye term
    bool scaled = false;       ///< whether the final image's super-resolution is resized
    detail::Resizing scale{};  ///< of the feature render, where `scaled`
    VecX<float> blank;         ///< behind the face alone, one number a channel
    double rate = 1;           ///< of the learning rates
};

/// Draws of a run's second stage.
class SampleDraws {
  public:
    /// The capture and the configuration must outlive it.
    SampleDraws(const Capture& capture, const TrainConfig& config);

    Index total() const { return total_; } ///< steps of the stage
    SampleDraw operator()(Index step) const;

  private:
    const Capture* capture_;
    const TrainConfig* config_;
    Random random_;
    Index total_;
};

/// Images and drivers of a draw, for a step on the CPU.
AvatarSample<float> sample_of(const Capture& capture, const TrainConfig& config,
                              const SampleDraw& draw);

} // namespace rye::trainer
