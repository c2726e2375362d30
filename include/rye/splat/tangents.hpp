// SPDX-License-Identifier: Apache-2.0
/// rye/splat/tangents.hpp: a direction in the inputs of a render, and a render with its derivative
/// in that direction.
#pragma once

#include <vector>

#include <rye/autodiff/dual.hpp>
#include <rye/splat/raster.hpp>

namespace rye {

/// A direction in the inputs of a render; null inputs do not move.
template <class T, Distortion D = NoDistortion>
struct RasterTangents {
    const Gaussians<T>* gaussians = nullptr;  ///< tangents, in the shapes of the Gaussians
    /// Derivatives of the camera's focal lengths, principal point and pose. Size, near depth and
    /// lens do not move.
    const Pinhole<T, D>* camera = nullptr;
};

/// A render and the direction of its derivative.
template <class T, Distortion D>
struct RasterJvpInput {
    const GaussianView<T>& gaussians;
    const RasterTangents<T, D>& tangents;
    const Pinhole<T, D>& camera;
    const VecX<T>& background;
};

namespace detail {

/// Tangents of a Splat's numbers, but the cut-off, which does not move.
template <class T>
struct SplatTangent {
    T x, y, ux, vx, vy, log2_opacity, floor, depth;
};

} // namespace detail

/// A render and the derivative of its images.
template <class T, Outputs O>
struct RasterJvp {
    Raster<T, O> value;
    Columns<T> feature;      ///< C x pixels
    Columns<T> alpha;        ///< 1 x pixels
    Columns<T> depth;        ///< 1 x pixels, if the outputs have depth; else empty
    std::vector<detail::SplatTangent<T>> splats; ///< [visible Gaussians] for lanes only
};

namespace detail {

/// Returns x with the derivative dx.
template <class V>
RYE_HD Dual<V, 1> dual_of(const V& x, const V& dx) {
    Dual<V, 1> r;
    r.value = x;
    r.d[0] = dx;
    return r;
}

/// Returns the camera and its tangent in numbers Dual<V, 1>: V is the camera's kind of number, or a
/// batch of it.
template <class V, class T, Distortion D>
auto dual_camera(const Pinhole<T, D>& camera, const Pinhole<T, D>* tangent) {
    using Number = Dual<V, 1>;
    using Lens = decltype(camera.distortion.template cast<Number>());
    const auto of = [&](const auto& number) {
        return dual_of<V>(V(number(camera)), V(tangent != nullptr ? number(*tangent) : T(0)));
    };
    Pinhole<Number, Lens> c;
    c.fx = of([](const auto& p) { return p.fx; });
    c.fy = of([](const auto& p) { return p.fy; });
    c.cx = of([](const auto& p) { return p.cx; });
    c.cy = of([](const auto& p) { return p.cy; });
    c.width = camera.width;
    c.height = camera.height;
    c.near_depth = dual_of<V>(V(camera.near_depth), V(T(0)));
    c.distortion = camera.distortion.template cast<Number>();
    for (int i = 0; i < 9; ++i)
        c.camera_from_world.rotation.data()[i] =
            of([i](const auto& p) { return p.camera_from_world.rotation.data()[i]; });
    for (int i = 0; i < 3; ++i)
        c.camera_from_world.translation[i] =
            of([i](const auto& p) { return p.camera_from_world.translation[i]; });
    return c;
}

} // namespace detail

} // namespace rye
