// SPDX-License-Identifier: Apache-2.0
/// rye/geometry/camera.hpp: the pinhole camera, with or without lens distortion.
/// Frame (OpenCV): x right, y down, z forward; x_camera = R x_world + t. Image plane [px]:
/// u = fx x / z + cx, v = fy y / z + cy, where the centre of the first pixel is (0.5, 0.5). A lens
/// (geometry/distortion.hpp) first distorts (x / z, y / z); the default, no lens, costs nothing.
/// Source: Hartley and Zisserman, "Multiple View Geometry", 6.1.
#pragma once

#include <cmath>
#include <concepts>
#include <string>
#include <type_traits>

#include <rye/core/error.hpp>
#include <rye/core/format.hpp>
#include <rye/geometry/distortion.hpp>
#include <rye/geometry/rigid.hpp>

namespace rye {

/// A pinhole camera: intrinsics, pose, near plane and lens. Its frame has x right, y down, z
/// forward: these directions in the world are the rows of camera_from_world.rotation.
template <Scalar T, Distortion D = NoDistortion>
struct Pinhole {
    using scalar = T;
    using lens = D;

    T fx = T(1), fy = T(1);                        ///< focal lengths [px]
    T cx = T(0), cy = T(0);                        ///< principal point, anywhere [px]
    int width = 0, height = 0;                     ///< [px]
    Rigid<T> camera_from_world = {};
    T near_depth = constant<T>(0.01);              ///< closest visible depth [world units]
    [[no_unique_address]] D distortion = {};

    /// Returns the camera's centre in the world.
    RYE_HD Vec3<T> centre() const { return camera_from_world.inverse().translation; }

    /// Returns (u [px], v [px], depth [world units]) of a world point; the depth must not be 0. u
    /// and v are NaN outside the valid range of the lens.
    RYE_HD Vec3<T> project_point(const Vec3<T>& x_world) const {
        const Vec3<T> x = camera_from_world.apply(x_world);
        if constexpr (D::distorts) {
            const Vec2<T> s(x[0] / x[2], x[1] / x[2]);
            const Distorted<T> b = distortion.distort(s);
            const T nan = T(Limits<real_t<T>>::nan);
            const auto seen = within_lens(s, b.slope, T(distortion.fold()));
            return Vec3<T>(select(seen, T(fx * b.at[0] + cx), nan),
                           select(seen, T(fy * b.at[1] + cy), nan), x[2]);
        } else {
            return Vec3<T>(fx * x[0] / x[2] + cx, fy * x[1] / x[2] + cy, x[2]);
        }
    }

    /// Returns the unit direction in the world of the ray through an image point [px]; NaN if no
    /// ray of the lens reaches it.
    RYE_HD Vec3<T> ray(const Vec2<T>& pixel) const {
        Vec3<T> d((pixel[0] - cx) / fx, (pixel[1] - cy) / fy, T(1));
        if constexpr (D::distorts) {
            const Undistorted<T> s = undistort(distortion, Vec2<T>(d[0], d[1]));
            const T nan = T(Limits<real_t<T>>::nan);
            d[0] = s.reached ? s.slope[0] : nan;
            d[1] = s.reached ? s.slope[1] : nan;
        }
        return camera_from_world.turn_back(normalized(d));
    }

    template <Scalar U>
    auto cast() const {
        const auto to = [](const T& x) { return static_cast<U>(x); };
        const auto bent = distortion.template cast<U>();
        return Pinhole<U, std::remove_const_t<decltype(bent)>>{
            to(fx), to(fy), to(cx), to(cy), width, height,
            camera_from_world.template cast<U>(), to(near_depth), bent};
    }
};

/// A type with a size in pixels, a projection of world points, and rays through pixels.
template <class C>
concept Camera = requires(const C c, const Vec3<typename C::scalar> x, Vec2<typename C::scalar> p) {
    { c.width } -> std::convertible_to<int>;
    { c.height } -> std::convertible_to<int>;
    { c.project_point(x) } -> std::convertible_to<Vec3<typename C::scalar>>;
    { c.ray(p) } -> std::convertible_to<Vec3<typename C::scalar>>;
    { c.centre() } -> std::convertible_to<Vec3<typename C::scalar>>;
};
static_assert(Camera<Pinhole<float>> && Camera<Pinhole<float, BrownConrady<float>>>);

/// Returns the camera with a lens.
template <Scalar T, Distortion D>
    requires(D::distorts)
Pinhole<T, D> with_lens(const Pinhole<T>& c, const D& lens) {
    return {c.fx, c.fy, c.cx, c.cy, c.width, c.height, c.camera_from_world, c.near_depth, lens};
}

/// Size of an image.
struct ImageSize {
    int width, height;  ///< [px]
};

/// Returns a camera at `eye`, looking at `target` in the image centre. Throws an Error for bad
/// arguments.
template <Real T>
Pinhole<T> look_at(const Vec3<T>& eye, const Vec3<T>& target, const Vec3<T>& up, T vertical_fov_rad,
                   const ImageSize& size) {
    const auto [width, height] = size;
    require(width > 0 && height > 0, "look_at", "the image is ", width, " x ", height,
            " pixels, expected both positive");
    require(vertical_fov_rad > T(0) && vertical_fov_rad < T(3.14159265358979323846), "look_at",
            "the vertical field of view is ", vertical_fov_rad, " rad, expected between 0 and pi");
    const Vec3<T> z = normalized(Vec3<T>(target - eye));
    const Vec3<T> side = cross(z, normalized(up));
    require(norm(side) > T(1e-6), "look_at",
            "the up vector is parallel to the line of sight, or eye and target coincide");
    const Vec3<T> x = normalized(side), y = cross(z, x);
    Pinhole<T> camera;
    camera.width = width;
    camera.height = height;
    camera.fx = camera.fy = T(height) / (T(2) * std::tan(vertical_fov_rad / T(2)));
    camera.cx = T(width) / T(2);
    camera.cy = T(height) / T(2);
    camera.camera_from_world.rotation << x.transpose(), y.transpose(), z.transpose();
    camera.camera_from_world.translation = -(camera.camera_from_world.rotation * eye);
    return camera;
}

/// Returns the same view in an image `factor` times as large: 0.5 halves the size and the
/// intrinsics.
template <Scalar T, Distortion D>
Pinhole<T, D> scaled(Pinhole<T, D> camera, double factor) {
    const double w = std::round(camera.width * factor), h = std::round(camera.height * factor);
    require(w >= 1 && h >= 1 && w < 1e6 && h < 1e6, "scaled", "factor ", factor,
            " for an image of ", camera.width, " x ", camera.height,
            " pixels, expected a result of 1 to 999999 pixels a side");
    // Sizes that do not divide evenly scale x and y separately, so the field of view is unchanged.
    const T sx = T(w / camera.width), sy = T(h / camera.height);
    camera.fx = camera.fx * sx;
    camera.cx = camera.cx * sx;
    camera.fy = camera.fy * sy;
    camera.cy = camera.cy * sy;
    camera.width = static_cast<int>(w);
    camera.height = static_cast<int>(h);
    return camera;
}

} // namespace rye
