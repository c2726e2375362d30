// SPDX-License-Identifier: Apache-2.0
/// rye/splat/jvp.hpp: forward mode of the rasterizer: a render with its derivative in one direction
/// of the Gaussians, the camera, or both, at the price of two to two and a half renders.
///     RasterTangents<float> direction{.gaussians = &dg, .camera = &dcamera};
///     const auto r = rasterizer.jvp(backend, g, direction, camera, background);
///     r.value.feature.pixels, r.feature                        // the picture and its derivative
/// Plain loops run the render on duals. Lanes have a kernel of their own. Decisions (what is seen,
/// the order, where a pixel is full) are those of the value.
#pragma once

#include <vector>

#include <rye/splat/lanes.hpp>
#include <rye/splat/lanes/jvp.hpp>
#include <rye/splat/plain/jvp.hpp>

namespace rye::detail {

/// Rasterizer::jvp on backend B for scalars T: by duals of plain loops.
template <class B, class T>
struct SplatJvp {
    template <class R, Distortion D>
    static void run(const R& rasterizer, const B& backend, const RasterJvpInput<T, D>& in,
                    auto& out, RasterScratch<T>&) {
        check_tangent(in.gaussians, in.tangents);
        jvp_by_duals(rasterizer, backend, in, out);
    }

    /// Throws unless the tangent has the Gaussians' shape.
    template <Distortion D>
    static void check_tangent(const GaussianView<T>& g, const RasterTangents<T, D>& tangents) {
        if (tangents.gaussians == nullptr) return;
        const auto check = [&](const char* name, const Columns<T>& dx, Index rows) {
            require(dx.rows() == rows && dx.cols() == g.count(), "rasterizer", "tangent of ", name,
                    " is ", dx.rows(), " x ", dx.cols(), ", ", name, " is ", rows, " x ",
                    g.count());
        };
        check("mean", tangents.gaussians->mean, 3);
        check("rotation", tangents.gaussians->rotation, 4);
        check("scale", tangents.gaussians->scale, 3);
        check("opacity", tangents.gaussians->opacity, 1);
        check("feature", tangents.gaussians->feature, g.channels());
    }
};

template <class B, class T>
    requires LaneBackend<B, T>
struct SplatJvp<B, T> : SplatJvp<ScalarBackend<std::remove_cvref_t<decltype(B::threads)>>, T> {
    using Plain = ScalarBackend<std::remove_cvref_t<decltype(B::threads)>>;
    using V = typename B::template batch<T>;

    template <class R, Distortion D>
    static void run(const R& rasterizer, const B& backend, const RasterJvpInput<T, D>& in,
                    auto& out, RasterScratch<T>& s) {
        using A = std::remove_cvref_t<decltype(rasterizer.accuracy)>;
        const GaussianView<T>& g = in.gaussians;
        const RasterTangents<T, D>& tangents = in.tangents;
        const Pinhole<T, D>& camera = in.camera;
        SplatJvp::check_tangent(g, tangents);
        if constexpr (D::distorts || A::order == BlendOrder::by_peak || A::outputs.contributor) {
            jvp_by_duals(rasterizer, backend, in, out);
        } else {
            RasterTrace<T>& trace = out.value.trace;
            rasterizer.project_into(backend, g, camera, s);
            bin_and_sort(backend, SplatInput{g, camera, rasterizer.accuracy}, s, trace);
            const Index pixels = static_cast<Index>(camera.width) * camera.height;
            const auto shape = [&](Image<T>& image, Columns<T>& tangent, Index rows) {
                image.width = camera.width;
                image.height = camera.height;
                image.pixels.resize(rows, pixels);
                tangent.resize(rows, pixels);
            };
            shape(out.value.feature, out.feature, g.channels());
            shape(out.value.alpha, out.alpha, 1);
            if constexpr (A::outputs.depth) shape(out.value.depth, out.depth, 1);
            trace.used.resize(static_cast<std::size_t>(trace.lists.tiles()));

            std::vector<SplatTangent<T>>& splats = out.splats;
            splats.resize(trace.members.size());
            const auto dual = dual_camera<V>(camera, tangents.camera);
            const TangentInput<V, A> moves{g, tangents.gaussians, dual, rasterizer.accuracy};
            for_chunks(backend.threads, static_cast<Index>(splats.size()), 1024,
                       [&](Index b, Index e, Index) {
                           project_tangents(moves, trace, {b, e}, splats.data());
                       });
            const Scene<T> scene = R::scene_of(g, camera, in.background, trace);
            const TangentScene<T> moving{
                scene, splats.data(),
                tangents.gaussians != nullptr ? &tangents.gaussians->feature : nullptr,
                tangents.camera != nullptr ? tangents.camera->cx : T(0),
                tangents.camera != nullptr ? tangents.camera->cy : T(0)};
            for_chunks(backend.threads, trace.lists.tiles(), 2, [&](Index b, Index e, Index) {
                const auto canvas = s.workspaces.template acquire<LaneTangentCanvas<V>>();
                dispatch_channels<1, 3, 4>(g.channels(), [&](auto c) {
                    for (Index t = b; t < e; ++t)
                        blend_tile_jvp_lanes<V, c>(moving, rasterizer.accuracy, t, out, *canvas);
                });
            });
        }
    }
};

} // namespace rye::detail
