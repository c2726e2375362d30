// SPDX-License-Identifier: Apache-2.0
/// video_pairs.hpp: frames of a capture that `rye import video` made, beside those of the truth.
#pragma once

#include <map>
#include <string>
#include <vector>

#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>

#include "data/capture.hpp"

namespace rye::trainer {

/// Numbers of one frame in both captures.
struct VideoPair {
    int truth, got;
};

/// Returns the frames that both have, by their names. Throws an Error for fewer than three.
inline std::vector<VideoPair> pairs_of(const Capture& truth, const Capture& got) {
    std::map<std::string, int> by_id;
    for (int f = 0; f < truth.frame_count(); ++f)
        by_id[truth.frames[static_cast<std::size_t>(f)].id] = f;
    std::vector<VideoPair> pairs;
    for (int f = 0; f < got.frame_count(); ++f)
        if (const auto at = by_id.find(got.frames[static_cast<std::size_t>(f)].id);
            at != by_id.end())
            pairs.push_back({at->second, f});
    require(pairs.size() >= 3, got.folder.string(), "has ", pairs.size(), " frames of ",
            truth.folder.string(), ", expected 3 or more");
    return pairs;
}

/// Returns where the head of a frame is in the world.
inline Rigid<double> world_from_head(const Capture& c, int f) {
    const CaptureFrame& frame = c.frames[static_cast<std::size_t>(f)];
    return {so3_exp(Vec3<double>(frame.pose.head<3>())), frame.pose.tail<3>()};
}

/// Returns where the head of a frame is before the first camera.
inline Rigid<double> head_in_camera(const Capture& c, int f) {
    return compose(c.camera(f, 0).camera_from_world, world_from_head(c, f));
}

} // namespace rye::trainer
