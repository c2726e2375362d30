// SPDX-License-Identifier: Apache-2.0
/// importers/flame_params.hpp: the flame_param file of a frame, an npz file as exported by VHAP.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include <rye/io/bytes.hpp>
#include <rye/math/linalg.hpp>

namespace rye::trainer {

/// Numbers of a frame's flame_param file.
struct FlameParams {
    std::vector<double> expression;   ///< expr, then jaw_pose
    Mat3<double> rotation;            ///< of the head: the root's, then the neck's
    std::array<Vec3<double>, 2> gaze; ///< unit, head frame
};

/// Returns the numbers in these bytes. Throws an Error, with file (`who`), array and value, for a
/// missing array, a wrong number of numbers, a number that is not finite, and eyes that turn too
/// far.
FlameParams parse_flame_params(ByteSpan bytes, const std::string& who);
FlameParams read_flame_params(const std::filesystem::path& path);

} // namespace rye::trainer
