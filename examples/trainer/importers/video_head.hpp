// SPDX-License-Identifier: Apache-2.0
/// importers/video_head.hpp: the head that a video shows, from its tracks: camera, poses, landmarks,
/// eyeballs and gazes. World: x the subject's left, y up, z towards the camera, whose axes it has;
/// its origin is where the head is in the middle of the pictures. Head frame of rye, units of 1 dm.
#pragma once

#include <array>
#include <vector>

#include <rye/geometry/camera.hpp>

#include "importers/face_bundle.hpp"
#include "importers/video_tracks.hpp"

namespace rye::trainer {

struct HeadOptions {
    double focal = 0;        ///< focal length [px]; 0: found
    double iris_mm = 11.7;   ///< diameter of an iris, which sets the scale
};

/// An eyeball that is fixed in the head.
struct VideoEye {
    Vec3<double> centre; ///< head frame
    double radius = 0.12, limbus_radius = 0.0585, iris_plane = 0.1048; ///< [dm]
};

/// A head in one picture.
struct VideoPose {
    int picture = 0;              ///< of the tracks
    Rigid<double> world_from_head;
    Columns<double> landmarks;    ///< 3 x 468, world
    std::array<Vec3<double>, 2> gaze; ///< unit optical axes, head frame
    double residual = 0;          ///< of the landmarks, in their standard deviations
};

struct VideoHead {
    Pinhole<double> camera;
    double focal_deviation = 0;    ///< standard deviation of the focal length's logarithm
    std::vector<int> drivers;      ///< coefficients of the tracks that are expressions
    Columns<double> shapes;        ///< 3 x 468 rows, head frame, a column a driver
    std::array<VideoEye, 2> eyes;
    std::vector<VideoPose> poses;
    double landmark_error = 0;     ///< median of the landmarks' errors [px]
};

/// Returns what the tracker's coefficients eyeLook* say of both eyes: shares of their reach to the
/// subject's left, and up.
Vec2<double> tracked_look(const std::vector<std::string>& names, const TrackedPicture& picture);

/// Returns the direction of such a look, in the head frame.
Vec3<double> direction_of(const Vec2<double>& look);

/// Returns the optical axis of an average eye that looks in this direction; both in the head frame.
Vec3<double> usual_optical_axis(const Vec3<double>& visual, std::size_t eye);

/// Returns the head in these pictures of the tracks, each with one face.
VideoHead video_head(const Tracks& tracks, const std::vector<int>& pictures,
                     const HeadOptions& options);

} // namespace rye::trainer
