// SPDX-License-Identifier: Apache-2.0
#include "data/cameras_file.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>

#include "data/degrees.hpp"
#include "data/json_fields.hpp"
#include "data/picture.hpp"

namespace rye::trainer {
namespace {

using Json = nlohmann::json;

/// Fields of a camera; a field that it lacks is the whole file's, or null.
struct Fields {
    const Json& file;
    const Json& camera;

    const Json& find(const char* key) const {
        static const Json nothing;
        if (camera.contains(key)) return camera.at(key);
        return file.contains(key) ? file.at(key) : nothing;
    }
    const Json& at(const char* key) const {
        const Json& value = find(key);
        require(!value.is_null(), key, "is missing");
        return value;
    }
};

/// Returns rows x cols numbers from nested lists, or from one list if there is one row.
Eigen::MatrixXd matrix(const Json& value, std::size_t rows, std::size_t cols, const char* key) {
    Eigen::MatrixXd m(rows, cols);
    const auto row_of = [&](const Json& row, std::size_t i) {
        require(
            row.is_array() && row.size() == cols, key, "got ", [&] { return row.dump(); },
            ", expected ", cols, " numbers");
        for (std::size_t j = 0; j < cols; ++j)
            m(static_cast<Index>(i), static_cast<Index>(j)) = json_number(row.at(j), key);
    };
    if (rows == 1) {
        row_of(value, 0);
        return m;
    }
    require(value.is_array() && value.size() >= rows, key, "expected ", rows, " rows of ", cols,
            " numbers");
    for (std::size_t i = 0; i < rows; ++i) row_of(value.at(i), i);
    return m;
}

ImageSize size_of(const Json& value) {
    const Eigen::MatrixXd size = matrix(value, 1, 2, "size");
    for (const double side : {size(0, 0), size(0, 1)})
        require(
            side >= 1 && side <= max_image_edge && side == std::floor(side), "size", "got ",
            [&] { return value.dump(); }, ", expected width and height, each 1 to ", max_image_edge,
            " pixels");
    return {static_cast<int>(size(0, 0)), static_cast<int>(size(0, 1))};
}

void require_known(const Json& from, const std::vector<std::string_view>& known) {
    for (const auto& [key, value] : from.items())
        if (std::find(known.begin(), known.end(), key) == known.end()) {
            std::string all;
            for (const std::string_view k : known)
                all += (all.empty() ? "" : ", ") + std::string(k);
            throw Error(key + ": is unknown here, expected some of " + all);
        }
}

Pinhole<double> by_matrices(const Fields& of) {
    const auto [width, height] = size_of(of.at("size"));
    const Eigen::MatrixXd k = matrix(of.at("intrinsic"), 3, 3, "intrinsic");
    const Eigen::MatrixXd m = matrix(of.at("extrinsic"), 3, 4, "extrinsic");
    require(k(0, 0) > 0 && k(1, 1) > 0 && k(0, 1) == 0 && k(1, 0) == 0 && k(2, 0) == 0 &&
                k(2, 1) == 0 && k(2, 2) == 1,
            "intrinsic", "expected the rows (fx 0 cx), (0 fy cy), (0 0 1) with fx and fy > 0");
    const Mat3<double> r = m.leftCols<3>();
    const Vec3<double> x = r.row(0), y = r.row(1), z = r.row(2);
    require(
        (r * r.transpose() - Mat3<double>::Identity()).cwiseAbs().maxCoeff() < most_off_rotation &&
            dot(cross(x, y), z) > 0,
        "extrinsic", "its 3 x 3 part is no rotation, expected one");
    Pinhole<double> c;
    c.fx = k(0, 0), c.fy = k(1, 1), c.cx = k(0, 2), c.cy = k(1, 2);
    c.width = width, c.height = height;
    c.camera_from_world.rotation = r;
    c.camera_from_world.translation = m.col(3);
    return c;
}

Pinhole<double> by_place(const Fields& of) {
    const auto point = [&](const char* key) -> Vec3<double> {
        return matrix(of.at(key), 1, 3, key).transpose();
    };
    const double fov = json_number(of.at("fov"), "fov");
    require(
        fov > 0 && fov < 180, "fov", "got ", [&] { return of.at("fov").dump(); },
        ", expected degrees between 0 and 180");
    return look_at<double>(point("eye"), point("look_at"), point("up"), fov * degree,
                           size_of(of.at("size")));
}

Photograph camera_of(const Json& file, const Json& camera) {
    require(
        camera.is_object(), "a camera", "got ", [&] { return camera.dump(); },
        ", expected an object");
    require_known(camera,
                  {"name", "eye", "look_at", "up", "fov", "size", "intrinsic", "extrinsic"});
    const Fields of{file, camera};
    const bool matrices = camera.contains("extrinsic");
    require(matrices != camera.contains("eye"), "a camera",
            "expected 'eye' (with look_at, up and fov) or 'extrinsic' (with intrinsic)");
    Photograph p;
    p.file = json_text(camera, "name", "", "a camera");
    p.camera = matrices ? by_matrices(of) : by_place(of);
    return p;
}

} // namespace

ImageSize parsed_size(const std::string& text, const std::string& who) {
    int width = 0, height = 0;
    const char* const end = text.data() + text.size();
    const auto [x, no_width] = std::from_chars(text.data(), end, width);
    bool read = no_width == std::errc() && x != end && *x == 'x';
    if (read) {
        const auto [stop, no_height] = std::from_chars(x + 1, end, height);
        read = no_height == std::errc() && stop == end;
    }
    require(read && width > 0 && height > 0 && width <= max_image_edge && height <= max_image_edge,
            who, "got ", text, ", expected WxH, each 1 to ", max_image_edge, " pixels");
    return {width, height};
}

std::vector<Photograph> parse_cameras(std::string_view text, const std::string& name) {
    const Json json = parse_json_text(text, name);
    require(json.is_object() && (json.contains("cameras") || json.contains("frames")), name,
            "got neither 'cameras' nor 'frames', expected the one of rye or the other of a "
            "transforms.json");
    std::vector<Photograph> all;
    if (json.contains("cameras")) {
        std::string who = name;
        try {
            require_known(json, {"cameras", "look_at", "up", "fov", "size", "intrinsic"});
            require(json.at("cameras").is_array(), "cameras", "expected a list");
            for (const Json& camera : json.at("cameras")) {
                who = name + ": camera " + std::to_string(all.size());
                all.push_back(camera_of(json, camera));
            }
        } catch (const Json::exception& e) {
            throw Error(who + ": " + e.what());
        } catch (const Error& e) {
            throw Error(who + ": " + e.what());
        }
    } else {
        all = parse_photographs(text, name);
    }
    require(!all.empty(), name, "its list of cameras is empty, expected at least one");
    return all;
}

std::vector<Photograph> read_cameras(const std::filesystem::path& path) {
    return parse_cameras(as_text(read_file(path, max_json_bytes)), path.string());
}

} // namespace rye::trainer
