// SPDX-License-Identifier: Apache-2.0
/// rye/splat/lanes.hpp: the rasterizer for backends with lanes: include this in the place of
/// splat/rasterizer.hpp. A camera whose lens bends has its Gaussians projected one at a time; the
/// pixels are walked in lanes all the same.
#pragma once

#include <type_traits>

#include <rye/splat/lanes/forward.hpp>
#include <rye/splat/lanes/stage.hpp>
#include <rye/splat/lanes/vjp.hpp>
#include <rye/splat/rasterizer.hpp>

namespace rye::detail {

/// Calls f with the number of channels as a constant if it is one of the few, else with 0.
template <int... Few, class F>
void dispatch_channels(Index channels, F&& f) {
    const bool few =
        ((channels == Few && (f(std::integral_constant<int, Few>()), true)) || ... || false);
    if (!few) f(std::integral_constant<int, 0>());
}

/// The kernels of PlainSplatKernels, in lanes.
template <class B, class T>
    requires LaneBackend<B, T>
struct SplatKernels<B, T> {
    using V = typename B::template batch<T>;

    template <class A, Distortion D>
    static void project(const SplatInput<A, T, D>& in, ChunkRange r, RasterScratch<T>& s) {
        if constexpr (D::distorts)
            project_range(in, r, s);
        else
            project_range_lanes<V>(in, r, s);
    }
    template <class A>
    static void blend(const Scene<T>& scene, const A& accuracy, const DrawnTiles& drawn,
                      Raster<T, A::outputs>& out, Workspaces& workspaces) {
        const auto canvas = workspaces.template acquire<LaneCanvas<V>>();
        dispatch_channels<1, 3, 4, 8>(scene.channels(), [&](auto c) {
            blend_tiles_lanes<V, c>(scene, accuracy, drawn, out, *canvas);
        });
    }
    template <class A>
    static void blend_vjp(const Scene<T>& scene, const A& accuracy, const RasterCotangent<T>& g,
                          ChunkRange r, RasterScratch<T>& s) {
        const auto tape = s.workspaces.template acquire<LaneTape<V>>();
        const bool extra = g.alpha != nullptr || g.depth != nullptr;
        dispatch_channels<1, 3, 4>(scene.channels(), [&](auto c) {
            for (Index t = r.begin; t < r.end; ++t)
                if (extra)
                    blend_tile_vjp_lanes<V, c, true>(scene, accuracy, {g, t}, s, *tape);
                else
                    blend_tile_vjp_lanes<V, c, false>(scene, accuracy, {g, t}, s, *tape);
        });
    }
    template <class A, Distortion D>
    static void project_vjp(const SplatInput<A, T, D>& in, const RasterTrace<T>& trace,
                            ChunkRange r, RasterScratch<T>& s, Gaussians<T>& out) {
        if constexpr (D::distorts) {
            project_vjp_range(in, {trace, s.slots}, r, out);
        } else {
            const auto sums = s.workspaces.template acquire<LaneSums<V>>();
            project_vjp_range_lanes<V>(in, {trace, s.slots}, r, out, *sums);
        }
    }
};

} // namespace rye::detail
