// SPDX-License-Identifier: Apache-2.0
/// model/draws.hpp: the random choices of a step of stage 2: a function of (configuration, seed,
/// step, picture of the step) alone, whichever rank takes it. Steps on the CPU and on a device use the same draws, and a resumed run continues
/// with those of the interrupted one.
#pragma once

#include <vector>

#include <rye/train/augment.hpp>
#include <rye/train/capture_samples.hpp>

#include "data/samples.hpp"
#include "model/ranks.hpp"

namespace rye::trainer {

/// Returns the frame of a step; the order within an epoch depends on seed and epoch alone.
int frame_of_step(const std::vector<int>& frames, Index step, const Random& random);

/// Returns the picture of a step, as frame_of_step returns a frame.
FrameCamera picture_of_step(const std::vector<FrameCamera>& pictures, Index step,
                            const Random& random);

/// Returns all pictures of the training frames.
std::vector<FrameCamera> training_pictures(const Capture& capture);

/// Returns the cameras that have an image of a frame; throws an Error if there is none.
std::vector<int> present_cameras(const Capture& capture, int frame);

/// Returns the remaining share of a learning rate that falls to `decay` of itself in `total` steps.
double decayed(double decay, Index step, Index total);

/// Returns the number of steps of a stage: `steps` if above 0, else those of its epochs.
Index total_steps(const MeshTrainConfig& stage, const Capture& capture);
Index total_steps(const AvatarTrainConfig& stage, const Capture& capture);

/// Frame, camera, colour and scale for one picture of a step of stage 2.
struct SampleDraw {
    Index step = 0;
    int frame = 0, camera = 0; ///< of the capture
    bool eyes_high = true;     ///< true if the step takes the high-resolution eye term
    bool scaled = false;       ///< true if the final image's super-resolution is resized
    rye::detail::Resizing scale{};  ///< of the feature render, if `scaled`
    VecX<float> blank;         ///< background of the face alone, one number per channel
    double rate = 1;           ///< factor of the learning rates
};

/// Draws of a run's second stage.
class SampleDraws {
  public:
    /// Keeps references: the capture and the configuration must outlive it.
    SampleDraws(const Capture& capture, const TrainConfig& config);

    Index total() const { return total_; } ///< steps of the stage
    /// Returns picture `view` of a step, of those that the configuration's steps have.
    SampleDraw operator()(Index step, Index view = 0) const;

  private:
    const Capture* capture_;
    const TrainConfig* config_;
    std::vector<FrameCamera> pictures_; ///< of an epoch over pictures; empty for one over frames
    Random random_;
    Index total_;
};

/// Returns the pictures of a step that a rank (null: one alone) takes.
StepShare share_of(const TrainConfig& config, const Ranks* ranks);

/// Returns the images and drivers of a draw, for a step on the CPU.
AvatarSample<float> sample_of(const Capture& capture, const TrainConfig& config,
                              const SampleDraw& draw);

} // namespace rye::trainer
