// SPDX-License-Identifier: Apache-2.0
#include "importers/opencv_xml.hpp"

#include <cmath>
#include <optional>
#include <sstream>

#include <Eigen/LU>

#include <rye/io/bytes.hpp>
#include <rye/core/error.hpp>
#include <rye/core/parse.hpp>

namespace rye::trainer {
namespace {

/// Returns the text between <name ...> and </name>; empty if there is none.
std::string element(const std::string& text, const std::string& name) {
    for (std::size_t at = text.find("<" + name); at != std::string::npos;
         at = text.find("<" + name, at + 1)) {
        const std::size_t after = at + 1 + name.size();
        if (after >= text.size() || (text[after] != '>' && text[after] != ' ')) continue;
        const std::size_t begin = text.find('>', after);
        const std::size_t end = text.find("</" + name + ">", after);
        if (begin == std::string::npos || end == std::string::npos || end < begin) return {};
        return text.substr(begin + 1, end - begin - 1);
    }
    return {};
}

} // namespace

OpencvXml read_opencv_xml(const std::filesystem::path& path) {
    const Bytes bytes = read_file(path, 1U << 24U);
    return {std::string(as_text(bytes)), path.string()};
}

std::vector<double> OpencvXml::matrix(const std::string& name, int rows, int cols) const {
    const std::string who = who_ + ": " + name;
    const std::string matrix = element(text_, name);
    require(!matrix.empty(), who, "is missing, expected a matrix of OpenCV's XML");
    std::istringstream in(element(matrix, "data"));
    std::vector<double> values;
    for (std::string word; in >> word;) {
        const std::optional<double> x = parse_double(word);
        require(x && std::isfinite(*x), who, "got '", word, "', expected a finite number");
        values.push_back(*x);
    }
    require(values.size() == static_cast<std::size_t>(rows * cols), who, "got ", values.size(),
            " numbers, expected ", rows, " x ", cols);
    return values;
}

Rigid<double> OpencvXml::pose() const {
    const std::vector<double> r = matrix("cam_rotation", 3, 3);
    const std::vector<double> t = matrix("cam_translation", 3, 1);
    Rigid<double> pose;
    pose.rotation = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(r.data());
    pose.translation = Vec3<double>(t[0], t[1], t[2]);
    const double off = (pose.rotation * pose.rotation.transpose() - Mat3<double>::Identity())
                           .cwiseAbs()
                           .maxCoeff();
    require(off < 1e-3 && pose.rotation.determinant() > 0, who_ + ": cam_rotation",
            "is no rotation: R R^T differs from the identity by ",
            [&] { return std::to_string(off); });
    return pose;
}

} // namespace rye::trainer
