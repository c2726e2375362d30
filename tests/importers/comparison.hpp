// SPDX-License-Identifier: Apache-2.0
/// tests/importers/comparison.hpp: differences of an imported capture from the true one. Worlds may
/// differ by a similarity, which cameras and landmarks determine; head frames by a motion that all
/// frames share.
#pragma once

#include <string>
#include <vector>

#include "data/capture.hpp"
#include "synthetic_capture/scene.hpp"

namespace rye::trainer {

/// 4 frames, 3 cameras, 160 x 160 pixels.
CaptureSettings small_settings();

/// x_to = size R x_from + t.
struct Similarity {
    double size = 1;
    Rigid<double> motion;
    Vec3<double> operator()(const Vec3<double>& x) const {
        return motion.apply(Vec3<double>(size * x));
    }
};

/// Returns the similarity from the world of a frame of an import to that of the true capture.
Similarity to_truth(const Capture& truth, const Capture& got, int frame);

/// Differences over some frames; lengths in true world units unless named otherwise.
struct Comparison {
    double gaze_deg = 0; ///< largest, of optical axes in the world
    double mean_gaze_deg = 0;
    double pose_deg = 0, pose_mm = 0; ///< root mean square, of heads in the world
    double landmarks = 0;             ///< largest
    double landmarks_mm = 0;          ///< root mean square of a coordinate
    double centres = 0;               ///< largest, of eyeballs
    double mean_centres_mm = 0;       ///< 0 if the import has none
    double projection_px = 0;   ///< largest, of landmarks in the images, each by its own camera
    double mask_difference = 0; ///< mean over pixels, of 1
    double eye_overlap = 1;     ///< smallest intersection over union of an eye of 40 pixels or more
    double mean_overlap = 0;
    std::string text() const;
};

/// Returns the differences over these frames, or over all if there are none; frames and cameras are
/// compared in their order.
Comparison compare(const Capture& truth, const Capture& got, std::vector<int> frames = {});

} // namespace rye::trainer
