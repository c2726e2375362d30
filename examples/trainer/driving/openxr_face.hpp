// SPDX-License-Identifier: Apache-2.0
/// driving/openxr_face.hpp: eyes and expressions as OpenXR's structs have them, written as JSON
/// under their own names; without OpenXR's headers.
#pragma once

#include <string>
#include <vector>

#include "data/json.hpp"
#include "driving/face_track.hpp"

namespace rye::trainer {

/// Returns ARKit's names of the coefficients that read_openxr makes of the weights.
std::vector<std::string> openxr_names();

/// Reads {"gaze": [XrEyeGazeFB, XrEyeGazeFB], "weights": [70], "head": XrPosef}, each optional but
/// one of the first two. Poses: +x right, +y up, -z forward [m]; those of gazes are in the space of
/// `head`, or in the head's if there is none. Eyes that are not isValid have no gaze. Returns false
/// if nothing was seen. Throws an Error with `who`, field and value.
bool read_openxr(const nlohmann::json& picture, TrackedFace& face, const std::string& who);

} // namespace rye::trainer
