// SPDX-License-Identifier: Apache-2.0
/// rye/geometry/opengl.hpp: conversion of the matrices of an OpenGL, WebGPU or Direct3D renderer to
/// a pinhole camera.
/// Matrices multiply columns: clip = projection * view * (x_world, 1). Eye frame of `view`
/// (OpenGL): x right, y up, z toward the viewer, right-handed. Normalised device coordinates clip /
/// clip.w: x from -1 at the left edge of the image to 1 at the right, y from -1 at the bottom edge
/// to 1 at the top; the range of z is ClipDepth. The result is in rye's frame (camera.hpp): x
/// right, y down, z forward, pixels from the upper left corner. The world is the same.
/// Eigen and OpenGL both store columns one after another, so memory is viewed without a copy:
///     pinhole_from_opengl<float>(Eigen::Map<const Mat<float, 4, 4>>(view), ...)
/// Source: OpenGL 4.6 core specification, 13.8 and the perspective matrix of its compatibility
/// profile, 12.1.1.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>

#include <rye/core/error.hpp>
#include <rye/core/format.hpp>
#include <rye/geometry/camera.hpp>

namespace rye {

/// Normalised device z of the near and far planes, which defines the third row of a projection.
enum class ClipDepth {
    minus_one_to_one, ///< near -1, far 1: OpenGL's default
    zero_to_one,      ///< near 0, far 1: Direct3D, Metal, Vulkan, WebGPU, glClipControl
    one_to_zero       ///< near 1, far 0: reversed, for precision; far may be infinite
};

namespace detail {

/// Largest error of a view's rotation (entries of R R' - I), and of the entries that a pinhole
/// camera's projection lacks, relative to the matrix's last row: it admits rounding of floats.
inline constexpr double opengl_tolerance = 1e-4;

template <Real T>
void check_view(const Mat<T, 4, 4>& view) {
    const char* const who = "pinhole_from_opengl";
    require(view.allFinite(), who, "the view has a number that is not finite");
    for (int j = 0; j < 4; ++j)
        require(std::abs(view(3, j) - T(j == 3)) <= T(opengl_tolerance), who, "view(3, ", j,
                ") is ", view(3, j), ", expected ", (j == 3 ? "1" : "0"),
                ": a rigid motion, as columns");
    const Mat3<T> r = view.template topLeftCorner<3, 3>();
    const T off = (r * r.transpose() - Mat3<T>::Identity()).cwiseAbs().maxCoeff();
    require(off <= T(opengl_tolerance), who,
            "the view scales or shears: its 3 x 3 part R has R R' - I up to ", off,
            ", expected at most ", T(opengl_tolerance));
    const T det = dot(Vec3<T>(r.col(0)), cross(Vec3<T>(r.col(1)), Vec3<T>(r.col(2))));
    require(det > T(0), who, "the view mirrors: determinant ", det,
            ", expected 1 (a right-handed world and eye frame)");
}

/// Throws an Error unless a projection with the last row (0, 0, -1, 0) is that of a pinhole camera.
template <Real T>
void check_projection(const Mat<T, 4, 4>& p) {
    const char* const who = "pinhole_from_opengl";
    const auto zero = [&](int i, int j, const char* meaning) {
        require(std::abs(p(i, j)) <= T(opengl_tolerance), who, "projection(", i, ", ", j, ") is ",
                p(i, j), ", expected 0: ", meaning);
    };
    zero(0, 1, "a pinhole camera has no skew");
    zero(1, 0, "a pinhole camera has no skew");
    zero(0, 3, "a perspective projection has no shift of its own; it belongs to the view");
    zero(1, 3, "a perspective projection has no shift of its own; it belongs to the view");
    zero(2, 0, "an oblique near plane is not supported");
    zero(2, 1, "an oblique near plane is not supported");
    require(p(0, 0) > T(0), who, "projection(0, 0) is ", p(0, 0),
            ", expected a positive number: the image is mirrored");
    require(p(1, 1) > T(0), who, "projection(1, 1) is ", p(1, 1),
            ", expected a positive number: the image is upside down; for Vulkan, whose device "
            "y points down, negate the second row");
}

} // namespace detail

/// Returns the camera of a view (world to eye) and a perspective projection, for an image of width
/// x height pixels; off-centre projections (glFrustum) give a principal point off the centre. The
/// near plane, by `clip`, is the camera's near_depth [world units]; a far plane is not kept. A
/// positive multiple of the specification's matrix is the same camera, as clip coordinates are
/// homogeneous. Throws an Error, with the entry and its value, for an empty image, numbers that are
/// not finite, a view that is not rigid or mirrors, a projection that is orthographic, left-handed,
/// skewed, mirrored or has an oblique near plane, and a near plane that is not in front.
template <Real T>
Pinhole<T> pinhole_from_opengl(const Mat<T, 4, 4>& view, const Mat<T, 4, 4>& projection, int width,
                               int height, ClipDepth clip = ClipDepth::minus_one_to_one) {
    const char* const who = "pinhole_from_opengl";
    require(width > 0 && height > 0, who, "the image is ", width, " x ", height,
            " pixels, expected both positive");
    detail::check_view<T>(view);
    require(projection.allFinite(), who, "the projection has a number that is not finite");
    const T into = -projection(3, 2);
    const auto row = [&] {
        std::string s = "(";
        for (int j = 0; j < 4; ++j) s += number_text(projection(3, j)) + (j < 3 ? ", " : ")");
        return "the projection's last row is " + s;
    };
    const T most = std::max(std::abs(into), std::abs(projection(3, 3)));
    require(std::abs(into) > T(detail::opengl_tolerance) * most && most > T(0), who, row,
            ", expected a multiple of (0, 0, -1, 0): this one is orthographic");
    require(into > T(0), who, row,
            ", expected a positive multiple of (0, 0, -1, 0): this one is left-handed");
    const Mat<T, 4, 4> p = projection / into;
    for (const int j : {0, 1, 3})
        require(std::abs(p(3, j)) <= T(detail::opengl_tolerance), who, row,
                ", expected a multiple of (0, 0, -1, 0)");
    detail::check_projection<T>(p);

    // Device z is -p22 + p23 / depth.
    const T at = clip == ClipDepth::minus_one_to_one ? T(-1)
                 : clip == ClipDepth::zero_to_one    ? T(0)
                                                     : T(1);
    const T near_depth = p(2, 3) / (at + p(2, 2));
    const bool grows = clip != ClipDepth::one_to_zero; // device z increases with depth
    require(std::isfinite(near_depth) && near_depth > T(0) && (p(2, 3) < T(0)) == grows, who,
            "projection(2, 2) is ", p(2, 2), " and projection(2, 3) ", p(2, 3),
            ", which puts the near plane of device z ", at, " at depth ", near_depth,
            ", expected a positive one, before the far plane: see ClipDepth");
    Pinhole<T> camera;
    camera.width = width;
    camera.height = height;
    const T half_width = T(width) / T(2), half_height = T(height) / T(2);
    camera.fx = p(0, 0) * half_width;
    camera.fy = p(1, 1) * half_height;
    camera.cx = (T(1) - p(0, 2)) * half_width;
    camera.cy = (T(1) + p(1, 2)) * half_height;
    camera.near_depth = near_depth;
    camera.camera_from_world.rotation = view.template topLeftCorner<3, 3>();
    camera.camera_from_world.rotation.template bottomRows<2>() *= T(-1);
    camera.camera_from_world.translation = Vec3<T>(view(0, 3), -view(1, 3), -view(2, 3));
    return camera;
}

} // namespace rye
