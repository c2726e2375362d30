// SPDX-License-Identifier: Apache-2.0
/// synthetic_capture/video_scene.hpp: a head that one camera films: it turns, changes its expression
/// and looks around, with all labels known. World and units of scene.hpp; angles in degrees.
#pragma once

#include <functional>
#include <optional>

#include "synthetic_capture/scene.hpp"

namespace rye::trainer {

struct VideoSettings {
    int frames = 120;        ///< pictures of the video
    int rate = 10;           ///< pictures per second
    double distance = 4.6;   ///< of the camera from the head's middle [dm]
    double focal = 1.05;     ///< focal length over the edge of the picture
    double turn_deg = 40;    ///< the head turns by this to both sides
    double nod_deg = 14, tilt_deg = 6;
    bool hand_held = false;  ///< the camera sways by 2 degrees and 2 centimetres
    /// Returns the dot that the eyes look at, at a time of the video [s]: to the right and up from
    /// the camera in its plane, as the person sees it [mm]. Without one eyes look around.
    std::function<std::optional<Vec2<double>>(double)> dot;
};

/// Returns the scene of a video: one camera, and frames whose pose and expression move smoothly;
/// the eyes jump from one fixation to the next, twice a second, or look at dots, in whose first third
/// the head is nearly still. Every fifth frame is a test frame. With hand_held the world is the
/// camera's: head and lights move in it.
/// Throws an Error for settings out of their bounds.
CaptureScene video_scene(const HeadModel& model, const CaptureSettings& settings,
                         const VideoSettings& video);

} // namespace rye::trainer
