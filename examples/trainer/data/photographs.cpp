// SPDX-License-Identifier: Apache-2.0
#include "data/photographs.hpp"

#include <array>
#include <cmath>

#include "data/json.hpp"
#include "data/picture.hpp"

namespace rye::trainer {
namespace {

using Json = nlohmann::json;
namespace fs = std::filesystem;

/// A number of the frame, or else of the file, or else `otherwise`.
double number(const Json& file, const Json& frame, const char* key, double otherwise) {
    const Json& from = frame.contains(key) ? frame : file;
    if (!from.contains(key)) return otherwise;
    const double x = from.at(key).get<double>();
    require(std::isfinite(x), key, "is not finite");
    return x;
}

/// Camera models that k1, k2, k3, p1 and p2 cover.
constexpr std::array models{"OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"};

Photograph photograph(const Json& file, const Json& frame) {
    const auto of = [&](const char* key, double otherwise) {
        return number(file, frame, key, otherwise);
    };
    const std::string model =
        (frame.contains("camera_model") ? frame : file).value("camera_model", "OPENCV");
    bool known = false;
    for (const char* name : models) known = known || model == name;
    require(known, "camera_model",
            "got " + model + ", expected OPENCV: undistort the photographs first");
    for (const char* key : {"k4", "k5", "k6"})
        require(of(key, 0) == 0, key, "got " + std::to_string(of(key, 0)) +
                                          ", expected 0: OPENCV has k1, k2, k3, p1 and p2");
    Photograph p;
    p.file = frame.value("file_path", "");
    Pinhole<double>& c = p.camera;
    const double w = of("w", 0), h = of("h", 0);
    require(w >= 1 && h >= 1 && w <= max_image_edge && h <= max_image_edge, "w and h",
            "got " + std::to_string(w) + " x " + std::to_string(h) + " pixels, expected 1 to " +
                std::to_string(max_image_edge));
    c.width = static_cast<int>(std::lround(w));
    c.height = static_cast<int>(std::lround(h));
    const double angle = of("camera_angle_x", 0);
    c.fx = of("fl_x", angle > 0 ? 0.5 * w / std::tan(0.5 * angle) : 0);
    c.fy = of("fl_y", c.fx);
    require(c.fx > 0 && c.fy > 0, "fl_x and fl_y",
            "got " + std::to_string(c.fx) + " and " + std::to_string(c.fy) + ", expected > 0 [px]");
    c.cx = of("cx", 0.5 * w);
    c.cy = of("cy", 0.5 * h);
    p.lens = {of("k1", 0), of("k2", 0), of("k3", 0), of("p1", 0), of("p2", 0)};
    const Json& m = frame.at("transform_matrix");
    Mat3<double> axes;
    Vec3<double> centre;
    for (std::size_t i = 0; i < 3; ++i) {
        const auto row = static_cast<Index>(i);
        for (std::size_t j = 0; j < 3; ++j)  // OpenGL's y and z are opposite
            axes(row, static_cast<Index>(j)) = (j == 0 ? 1 : -1) * m.at(i).at(j).get<double>();
        centre[row] = m.at(i).at(3).get<double>();
    }
    const Vec3<double> right = axes.col(0), down = axes.col(1), ahead = axes.col(2);
    require((axes.transpose() * axes - Mat3<double>::Identity()).cwiseAbs().maxCoeff() < 1e-3 &&
                dot(cross(right, down), ahead) > 0 && centre.allFinite(),
            "transform_matrix", "its 3 x 3 part is not a rotation");
    c.camera_from_world = Rigid<double>{axes, centre}.inverse();
    return p;
}

} // namespace

bool Photograph::bent() const {
    return lens.k1 != 0 || lens.k2 != 0 || lens.k3 != 0 || lens.p1 != 0 || lens.p2 != 0;
}

std::vector<Photograph> parse_photographs(std::string_view text, const std::string& name) {
    const Json json = parse_json_text(text, name);
    std::vector<Photograph> all;
    std::string who = name;
    try {
        for (const Json& frame : json.at("frames")) {
            who = name + ": frame " + std::to_string(all.size());
            all.push_back(photograph(json, frame));
        }
    } catch (const Json::exception& e) {
        throw Error(who + ": " + e.what());
    } catch (const Error& e) {
        throw Error(who + ": " + e.what());
    }
    return all;
}

std::vector<Photograph> read_photographs(const fs::path& path) {
    return parse_photographs(as_text(read_file(path, max_json_bytes)), path.string());
}

std::vector<double> lens_coefficients(const fs::path& path) {
    const Json json = read_json(path);
    std::vector<double> all;
    try {
        const auto add = [&](const Json& from) {
            for (const char* key : {"k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"})
                if (from.contains(key)) all.push_back(from.at(key).get<double>());
        };
        add(json);
        for (const Json& frame : json.at("frames")) add(frame);
    } catch (const Json::exception& e) {
        throw Error(path.string() + ": " + e.what());
    }
    return all;
}

} // namespace rye::trainer
