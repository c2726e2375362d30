// SPDX-License-Identifier: Apache-2.0
/// rye/io/capture_frame.hpp: the arrays of a capture: labels of one frame (params.npz,
/// lmk_3d.npy, vertices.npy, gaze.npz) and one camera. Errors name file, array and value.
/// Frames and units as in capture/capture.hpp.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <initializer_list>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <rye/io/capture.hpp>
#include <rye/io/npy.hpp>
#include <rye/io/npz.hpp>
#include <rye/core/error.hpp>
#include <rye/math/linalg.hpp>

namespace rye {

namespace detail {

/// Returns the finite values of an array, whose count must be one of `counts` (any if empty).
inline std::vector<double> finite_numbers(const NpyArray& array, const std::string& who,
                                          std::initializer_list<Index> counts) {
    const Index* end = counts.end();
    if (counts.size() > 0 && std::find(counts.begin(), end, array.size()) == end) {
        std::string expected;
        for (const Index n : counts)
            expected += (expected.empty() ? "" : " or ") + std::to_string(n);
        throw Error(who + ": got shape " + shape_text(array.shape) + ", expected " + expected +
                    " numbers");
    }
    std::vector<double> values = array.values<double>(who);
    for (std::size_t i = 0; i < values.size(); ++i)
        require(
            std::isfinite(values[i]), who, "value ", i, " is ",
            [&] { return std::to_string(values[i]); }, ", expected a finite number");
    return values;
}

/// The arrays of an npz and its file name.
struct NamedArrays {
    NamedArrays(const std::filesystem::path& file, std::uint64_t memory)
        : path(file), arrays(read_npz(file, memory)) {}

    std::string label(const std::string& name) const { return path.string() + ": " + name; }
    bool has(const std::string& name) const { return arrays.count(name) != 0; }
    std::vector<double> get(const std::string& name, std::initializer_list<Index> counts) const {
        const auto found = arrays.find(name);
        require(found != arrays.end(), label(name), "is missing from the file");
        return finite_numbers(found->second, label(name), counts);
    }
    Vec3<double> vector(const std::string& name) const {
        return Vec3<double>(get(name, {3}).data());
    }
    void require_shape(const std::string& name, const std::vector<Index>& shape) const {
        const std::vector<Index>& got = arrays.at(name).shape;
        require(
            got == shape, label(name), "got shape ", [&] { return shape_text(got); }, ", expected ",
            [&] { return shape_text(shape); });
    }

    std::filesystem::path path;
    NpzArrays arrays;
};

/// Returns points (N, 3) as 3 x N.
inline Columns<double> read_points(const std::filesystem::path& path) {
    const NpyArray array = read_npy(path);
    require(
        array.shape.size() == 2 && array.shape[1] == 3, path.string(), "got shape ",
        [&] { return shape_text(array.shape); }, ", expected (N, 3)");
    const std::vector<double> v = finite_numbers(array, path.string(), {});
    return Eigen::Map<const Columns<double>>(v.data(), 3, array.shape[0]);
}

/// Reads one eye of gaze.npz.
inline CaptureEye read_eye(const NamedArrays& file, std::size_t e) {
    CaptureEye eye;
    const std::string side = e == 0 ? "left" : "right";
    const auto vector = [&](const std::string& name) -> std::optional<Vec3<double>> {
        if (!file.has(name)) return std::nullopt;
        return file.vector(name);
    };
    const auto of_both = [&](const std::string& name) -> std::optional<double> {
        if (!file.has(name)) return std::nullopt;
        const double length = file.get(name, {2})[e];
        require(
            length > 0, file.label(name), "got ", [&] { return std::to_string(length); },
            " for the ", side, " eye, expected > 0");
        return length;
    };
    eye.optical = file.vector("gaze_" + side);
    eye.optical_world = vector("gaze_" + side + "_world");
    eye.visual = vector("visual_" + side);
    eye.centre = vector("eye_center_" + side);
    if (file.has("kappa_" + side))
        eye.kappa = Vec2<double>(file.get("kappa_" + side, {2}).data());
    eye.radius = of_both("eye_radius");
    eye.limbus_radius = of_both("limbus_radius");
    eye.iris_plane = of_both("iris_plane");
    return eye;
}

/// Returns the intrinsic matrix of a camera's file; throws an Error if it is no pinhole's.
inline Mat3<double> read_intrinsic(const NamedArrays& file) {
    const std::vector<double> v = file.get("intrinsic", {9});
    file.require_shape("intrinsic", {3, 3});
    const Mat3<double> k =
        Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(v.data());
    const std::string label = file.label("intrinsic");
    require(
        k(0, 0) > 0 && k(1, 1) > 0, label, "got focal lengths ",
        [&] { return std::to_string(k(0, 0)); }, " and ", [&] { return std::to_string(k(1, 1)); },
        ", expected > 0");
    require(
        std::abs(k(0, 1)) <= 1e-6 * k(0, 0), label, "got skew ",
        [&] { return std::to_string(k(0, 1)); }, ", expected 0");
    require(k(1, 0) == 0 && k(2, 0) == 0 && k(2, 1) == 0 && std::abs(k(2, 2) - 1) < 1e-9, label,
            "its rows are not (fx 0 cx), (0 fy cy), (0 0 1)");
    if (file.has("distortion"))
        for (const double x : file.get("distortion", {}))
            require(
                x == 0, file.label("distortion"), "got a coefficient of ",
                [&] { return std::to_string(x); },
                ", expected 0: captures are pinhole images, undistort them first");
    return k;
}

/// Returns world to camera; a last row (0 0 0 1) is optional. Throws an Error for no rotation.
inline Rigid<double> read_extrinsic(const NamedArrays& file) {
    const std::vector<double> m = file.get("extrinsic", {12, 16});
    file.require_shape("extrinsic", {m.size() == 12 ? 3 : 4, 4});
    const Mat<double, 3, 4> extrinsic =
        Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(m.data());
    const Mat3<double> r = extrinsic.leftCols<3>();
    const double skewed = (r * r.transpose() - Mat3<double>::Identity()).cwiseAbs().maxCoeff();
    require(skewed < 1e-3, file.label("extrinsic"),
            "its 3 x 3 part is no rotation: R R^T differs from the identity by ",
            [&] { return std::to_string(skewed); });
    const Vec3<double> x = r.row(0), y = r.row(1), z = r.row(2);
    require(cross(x, y).dot(z) > 0, file.label("extrinsic"),
            "its 3 x 3 part has determinant -1: the camera is mirrored (one axis negated)");
    return {r, extrinsic.col(3)};
}

/// Reads the labels of a frame from its folder params/`<frame>`. An npz may take so much memory
/// [bytes]. Throws an Error for what is missing or wrong.
inline CaptureFrame read_capture_labels(const std::filesystem::path& params, const std::string& id,
                                        std::uint64_t memory = default_memory) {
    CaptureFrame frame;
    frame.id = id;
    const detail::NamedArrays file(params / "params.npz", memory);
    const std::vector<double> pose = file.get("pose", {6});
    frame.pose = Eigen::Map<const Vec<double, 6>>(pose.data());
    if (file.has("scale")) frame.scale = file.get("scale", {1})[0];
    require(
        frame.scale > 0, file.label("scale"), "got ", [&] { return std::to_string(frame.scale); },
        ", expected > 0");
    for (const double weight : file.get("exp_coeff", {}))
        frame.expression.push_back(static_cast<float>(weight));
    frame.landmarks = common_landmarks(detail::read_points(params / "lmk_3d.npy"),
                                       (params / "lmk_3d.npy").string());
    frame.vertices.resize(3, 0);
    if (std::filesystem::exists(params / "vertices.npy"))
        frame.vertices = detail::read_points(params / "vertices.npy");
    if (std::filesystem::exists(params / "gaze.npz")) {
        const detail::NamedArrays gaze(params / "gaze.npz", memory);
        for (std::size_t e = 0; e < 2; ++e) frame.eyes[e] = detail::read_eye(gaze, e);
        frame.has_gaze = true;
        frame.has_centres = frame.eyes[0].centre.has_value() && frame.eyes[1].centre.has_value();
    }
    return frame;
}

} // namespace detail

/// Reads a camera_<name>.npz; its size is not in it. Throws an Error that names file and field.
inline Pinhole<double> read_view_camera(const std::filesystem::path& path,
                                        std::uint64_t memory = default_memory) {
    const detail::NamedArrays file(path, memory);
    const Mat3<double> k = detail::read_intrinsic(file);
    Pinhole<double> camera;
    camera.fx = k(0, 0);
    camera.fy = k(1, 1);
    camera.cx = k(0, 2);
    camera.cy = k(1, 2);
    camera.camera_from_world = detail::read_extrinsic(file);
    return camera;
}

} // namespace rye
