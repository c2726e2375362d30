// SPDX-License-Identifier: Apache-2.0
/// corrections/skin_poses.hpp: how the heads of frames are displaced from where their labels say,
/// by the skin: each camera shows the same points of the head in many frames, and where a frame's
/// head is elsewhere, its skin differs from that of the others. Tells what landmarks cannot that
/// move with a tracker's mesh. Source: Lucas and Kanade, 1981, with a rigid motion of the points;
/// the light of each frame by harmonics of degree 2 of the outward direction (Ramamoorthi and
/// Hanrahan, 2001), in logarithms of grey values.
#pragma once

#include <vector>

#include "data/capture.hpp"

namespace rye::trainer {

/// Displacements of heads.
struct SkinPoses {
    /// A motion of each frame: turn about the head's centre (axis-angle, [rad]) and shift
    /// [canonical units], both in the head's frame, of mean 0 over frames; empty without dense
    /// vertices.
    std::vector<Vec<double, 6>> moved;
    /// Robust root mean squares of the logarithms' differences, by the labels and after the
    /// motions.
    double before = 0, after = 0;
};

/// Returns the displacements in these frames, six or more, from all cameras. head: its centre in
/// the head's frame.
SkinPoses skin_poses(const Capture& capture, const std::vector<int>& frames,
                     const Vec3<double>& head);

} // namespace rye::trainer
