// SPDX-License-Identifier: Apache-2.0
/// training/cameras.hpp: cameras of a capture whose pose or focal length is wrong, found before a
/// training by the eyes in their pictures, which are not where labels and camera say, and
/// corrected. Cameras that are right to within the bound stay as they are, bit for bit. What is
/// found is where a camera's pictures show the head: a turn and a shift that show it alike share
/// it. Source: training/camera_fit.hpp; docs/refine.md.
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "data/capture.hpp"
#include "data/config.hpp"

namespace rye::trainer {

/// What was found about one camera, and what was done.
struct CameraFinding {
    std::string camera;
    int irises = 0;       ///< found in its pictures
    double off = 0;       ///< by which it displaces the head's landmarks, rms over frames [mm]
    double pixels = 0;    ///< the same in its pictures [px]
    bool wrong = false;   ///< above the bound: corrected
    double before = 0;    ///< median distance of irises from where they should be [px]
    double after = 0;     ///< the same by the camera that was found [px]
    double turn = 0;      ///< what was found differs from its numbers by this rotation [deg]
    double shift = 0;     ///< this motion of its centre [mm]
    double focal = 0;     ///< and this of its focal lengths [%]
};

/// What was found about all.
struct CameraFindings {
    std::vector<CameraFinding> all;
    double bound = 0;                    ///< of CameraFinding::off [mm]
    std::vector<std::string> not_judged; ///< sentences: which cameras, and why

    bool empty() const { return all.empty() && not_judged.empty(); }
    std::vector<std::string> lines() const;
    nlohmann::ordered_json json() const;
};

/// Judges the cameras of a capture that has gazes by its training frames, and corrects them in all
/// of its frames in which they have the same numbers. Deterministic: the same capture gives the
/// same bits.
CameraFindings correct_cameras(Capture& capture, const TrainConfig& config);

} // namespace rye::trainer
