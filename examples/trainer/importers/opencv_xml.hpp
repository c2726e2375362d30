// SPDX-License-Identifier: Apache-2.0
/// importers/opencv_xml.hpp: matrices in OpenCV's XML files.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <rye/geometry/rigid.hpp>

namespace rye::trainer {

/// A matrix, row by row, of `rows` x `cols` finite numbers. Throws Error, with file and name.
std::vector<double> read_opencv_matrix(const std::filesystem::path& path, const std::string& name,
                                       int rows, int cols);

/// cam_rotation and cam_translation of a calibration of ETH-XGaze, as stored.
Rigid<double> read_opencv_pose(const std::filesystem::path& path);

} // namespace rye::trainer
