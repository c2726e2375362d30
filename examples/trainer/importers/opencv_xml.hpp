// SPDX-License-Identifier: Apache-2.0
/// importers/opencv_xml.hpp: matrices in OpenCV's XML files.
#pragma once

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include <rye/geometry/rigid.hpp>

namespace rye::trainer {

/// Text of a file. Errors begin with its name.
class OpencvXml {
  public:
    OpencvXml(std::string text, std::string name) : text_(std::move(text)), who_(std::move(name)) {}

    /// Returns a matrix, row by row, of `rows` x `cols` finite numbers. Throws an Error, with file
    /// and name.
    std::vector<double> matrix(const std::string& name, int rows, int cols) const;
    /// Returns cam_rotation and cam_translation of a calibration of ETH-XGaze, as stored. Throws an
    /// Error for anything that is not a rotation.
    Rigid<double> pose() const;

  private:
    std::string text_, who_;
};

OpencvXml read_opencv_xml(const std::filesystem::path& path);

} // namespace rye::trainer
