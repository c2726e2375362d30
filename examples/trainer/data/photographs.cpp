// SPDX-License-Identifier: Apache-2.0
#include "data/photographs.hpp"

#include <array>
#include <cmath>

#include "data/json_fields.hpp"
#include "data/picture.hpp"

namespace rye::trainer {
namespace {

using Json = nlohmann::json;
namespace fs = std::filesystem;

/// Returns a number of the frame, or else of the file, or else `otherwise`.
double number(const Json& file, const Json& frame, const char* key, double otherwise,
              const std::string& who) {
    return json_number(frame.contains(key) ? frame : file, key, otherwise, who);
}

/// Returns a frame's pose, camera to world, from its matrix in OpenGL's axes: 3 or 4 rows of 4
/// numbers.
Rigid<double> world_from_camera(const Json& frame, const std::string& frame_name) {
    const std::string who = frame_name + ": transform_matrix";
    require(frame.contains("transform_matrix"), who, "is missing, expected 4 rows of 4 numbers");
    const Json& m = frame.at("transform_matrix");
    require(
        m.is_array() && (m.size() == 3 || m.size() == 4), who, "got ",
        [&] { return json_excerpt(m); }, ", expected 4 rows of 4 numbers");
    Mat3<double> axes;
    Vec3<double> centre;
    for (std::size_t i = 0; i < 3; ++i) {
        const std::string row_name = who + ": row " + std::to_string(i);
        require(
            m.at(i).is_array() && m.at(i).size() == 4, row_name, "got ",
            [&] { return json_excerpt(m.at(i)); }, ", expected 4 numbers");
        const auto row = static_cast<Index>(i);
        for (std::size_t j = 0; j < 3; ++j)  // OpenGL's y and z are opposite
            axes(row, static_cast<Index>(j)) = (j == 0 ? 1 : -1) * json_number(m.at(i).at(j), row_name);
        centre[row] = json_number(m.at(i).at(3), row_name);
    }
    const Vec3<double> right = axes.col(0), down = axes.col(1), ahead = axes.col(2);
    require((axes.transpose() * axes - Mat3<double>::Identity()).cwiseAbs().maxCoeff() < 1e-3 &&
                dot(cross(right, down), ahead) > 0,
            who, "its 3 x 3 part is not a rotation");
    return {axes, centre};
}

/// Camera models that need no more than k1, k2, k3, p1 and p2.
constexpr std::array models{"OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"};

Photograph photograph(const Json& file, const Json& frame, const std::string& who) {
    require(
        frame.is_object(), who, "got ", [&] { return json_excerpt(frame); },
        ", expected a photograph");
    const auto of = [&](const char* key, double otherwise) {
        return number(file, frame, key, otherwise, who);
    };
    const std::string model = json_text(frame.contains("camera_model") ? frame : file,
                                        "camera_model", "OPENCV", who);
    bool known = false;
    for (const char* name : models) known = known || model == name;
    require(known, who + ": camera_model", "got ", model,
            ", expected OPENCV: undistort the photographs first");
    for (const char* key : {"k4", "k5", "k6"})
        require(
            of(key, 0) == 0, who + ": " + key, "got ", [&] { return std::to_string(of(key, 0)); },
            ", expected 0: OPENCV has k1, k2, k3, p1 and p2");
    Photograph p;
    p.file = json_text(frame, "file_path", "", who);
    Pinhole<double>& c = p.camera;
    const double w = of("w", 0), h = of("h", 0);
    require(w >= 1 && h >= 1 && w <= max_image_edge && h <= max_image_edge, who + ": w and h",
            "got ", w, " x ", h, " pixels, expected 1 to ", max_image_edge);
    c.width = static_cast<int>(std::lround(w));
    c.height = static_cast<int>(std::lround(h));
    const double angle = of("camera_angle_x", 0);
    require(
        angle >= 0 && angle < 3.14159265358979323846, who + ": camera_angle_x", "got ",
        [&] { return std::to_string(angle); }, ", expected radians between 0 and pi");
    c.fx = of("fl_x", angle > 0 ? 0.5 * w / std::tan(0.5 * angle) : 0);
    c.fy = of("fl_y", c.fx);
    require(
        c.fx > 0 && c.fy > 0, who + ": fl_x and fl_y", "got ", [&] { return std::to_string(c.fx); },
        " and ", [&] { return std::to_string(c.fy); }, ", expected > 0 [px]");
    c.cx = of("cx", 0.5 * w);
    c.cy = of("cy", 0.5 * h);
    p.lens = {of("k1", 0), of("k2", 0), of("k3", 0), of("p1", 0), of("p2", 0)};
    c.camera_from_world = world_from_camera(frame, who).inverse();
    return p;
}

const Json& frames_of(const Json& file, const std::string& name) {
    return json_list(file, "frames", name, "a list of photographs");
}

} // namespace

bool Photograph::bent() const {
    return lens.k1 != 0 || lens.k2 != 0 || lens.k3 != 0 || lens.p1 != 0 || lens.p2 != 0;
}

std::vector<Photograph> parse_photographs(std::string_view text, const std::string& name) {
    const Json json = parse_json_text(text, name);
    std::vector<Photograph> all;
    for (const Json& frame : frames_of(json, name))
        all.push_back(photograph(json, frame, name + ": frame " + std::to_string(all.size())));
    return all;
}

std::vector<Photograph> read_photographs(const fs::path& path) {
    return parse_photographs(as_text(read_file(path, max_json_bytes)), path.string());
}

std::vector<double> lens_coefficients(const fs::path& path) {
    const Json json = read_json(path);
    const std::string name = path.string();
    std::vector<double> all;
    const auto add = [&](const Json& from, const std::string& who) {
        for (const char* key : {"k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"})
            if (from.contains(key)) all.push_back(json_number(from.at(key), who + ": " + key));
    };
    const Json& frames = frames_of(json, name);
    add(json, name);
    for (std::size_t i = 0; i < frames.size(); ++i)
        add(frames.at(i), name + ": frame " + std::to_string(i));
    return all;
}

} // namespace rye::trainer
