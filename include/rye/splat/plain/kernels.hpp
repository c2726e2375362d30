// SPDX-License-Identifier: Apache-2.0
/// rye/splat/plain/kernels.hpp: the kernels of Rasterizer on a backend's threads, chosen by the
/// backend's type. Here are the plain loops, for any scalar; splat/lanes.hpp adds those of lanes.
#pragma once

#include <vector>

#include <rye/splat/plain/stage.hpp>
#include <rye/splat/plain/vjp.hpp>

namespace rye::detail {

/// The kernels of Rasterizer as plain loops.
template <class T>
struct PlainSplatKernels {
    /// Projects Gaussians: candidate and state of each.
    template <class A, Distortion D>
    static void project(const SplatInput<A, T, D>& in, ChunkRange r, RasterScratch<T>& s) {
        project_range(in, r, s);
    }
    template <class A>
    static void blend(const Scene<T>& scene, const A& accuracy, const DrawnTiles& drawn,
                      Raster<T, A::outputs>& out, Workspaces&) {
        for (Index k = drawn.begin; k < drawn.end; ++k)
            blend_tile(scene, accuracy, drawn.tile(k), out);
    }
    /// Adds the partial gradients of tiles r to their slots.
    template <class A>
    static void blend_vjp(const Scene<T>& scene, const A& accuracy, const RasterCotangent<T>& g,
                          ChunkRange r, RasterScratch<T>& s) {
        std::vector<PixelContribution<T>> hits;
        for (Index t = r.begin; t < r.end; ++t) blend_tile_vjp(scene, accuracy, {g, t}, s, hits);
    }
    /// Computes the gradients of Gaussians from their slots.
    template <class A, Distortion D>
    static void project_vjp(const SplatInput<A, T, D>& in, const RasterTrace<T>& trace,
                            ChunkRange r, RasterScratch<T>& s, Gaussians<T>& out) {
        project_vjp_range(in, {trace, s.slots}, r, out);
    }
};

/// The kernels of backend B for scalars T.
template <class B, class T>
struct SplatKernels : PlainSplatKernels<T> {
    static_assert(!LaneBackend<B, T>,
                  "rasterizer: this backend has lanes; include <rye/splat/lanes.hpp>");
};

} // namespace rye::detail
