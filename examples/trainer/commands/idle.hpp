// SPDX-License-Identifier: Apache-2.0
/// commands/idle.hpp: a head that lives by itself, as options: --idle, --seed and --without.
#pragma once

#include <iosfwd>
#include <string>
#include <vector>

#include <rye/avatar/idle_head.hpp>

#include "commands/gaze_at.hpp"
#include "data/moving_picture.hpp"

namespace rye::trainer {

struct IdleOptions {
    double seconds = 0; ///< 0: not given
    std::string seed = "1";
    std::vector<std::string> without; ///< names of parts that are off

    bool given() const { return seconds > 0; }
    bool has(const std::string& part) const;
};

/// Adds --idle, --seed and --without.
void add_idle_options(CLI::App& command, IdleOptions& options);

/// Returns the coefficients of the capture that move lids. Their largest weights are those of its
/// frames, or 1 if it has a single frame.
LidCoefficients<float> lids_of(const Capture& capture);

/// Returns the pictures of --idle at `rate` pictures a second: `frames`, or the only one of them
/// repeated, with gazes and lids of their own. The eyes look at the point of --gaze-at, or where
/// they look in the first picture, which their reflex holds in the world while the head turns.
/// Prints what moves, and what is left out and why. Throws an Error if there are fewer frames than
/// pictures.
std::vector<DrawnFrame> idle_frames(const IdleOptions& options, const GazeAtOptions& at,
                                    const FrameRate& rate, const TrainState& state,
                                    const Capture& capture, std::vector<DrawnFrame> frames,
                                    std::ostream& say);

} // namespace rye::trainer
