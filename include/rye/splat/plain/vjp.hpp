// SPDX-License-Identifier: Apache-2.0
/// rye/splat/plain/vjp.hpp: the reverse pixel walk: each pixel's contributions are found as in the
/// forward walk, then walked from far to near by the step of splat/blend.hpp.
#pragma once

#include <rye/splat/plain/forward.hpp>

namespace rye {

/// Adds the gradients of one tile's pixels to the slots of its entries, in the order of pixels.
/// Adds the gradients of one tile's pixels to slots, which may be of a wider type S.
template <class A, class T, class S>
void blend_tile_vjp(const Scene<T>& scene, const A& accuracy,
                    const std::type_identity_t<detail::TileCotangent<T>>& cotangent,
                    RasterScratch<S>& scratch, std::vector<PixelContribution<T>>& hits) {
    const RasterCotangent<T>& g = cotangent.images;
    const Index tile = cotangent.tile;
    const Index channels = scene.channels();
    const detail::PlainBlend<A, T> blend(accuracy);
    for (int y = scene.top(tile); y < scene.bottom(tile); ++y)
        for (int x = scene.left(tile); x < scene.right(tile); ++x) {
            hits.clear();
            walk_pixel(scene, accuracy, {tile, x, y},
                       [&](const PixelContribution<T>& h) { hits.push_back(h); });
            const Index p = scene.pixel(x, y);
            const T* g_pixel = g.feature.data() + p * channels;
            const T g_alpha = g.alpha != nullptr ? (*g.alpha)(0, p) : T(0);
            const T g_depth = g.depth != nullptr ? (*g.depth)(0, p) : T(0);
            // One function for both sides, so that equal colours give equal sums.
            const auto along = [&](const T* colour) {
                T sum = T(0);
                for (Index c = 0; c < channels; ++c) sum += g_pixel[c] * colour[c];
                return sum;
            };
            T behind = along(scene.background.data());
            for (auto h = hits.rbegin(); h != hits.rend(); ++h) {
                const T* feature = scene.feature_of(h->entry);
                const Index at = scene.slot(h->entry);
                S* const slot = scratch.slots[at];
                S* const g_feature = slot + detail::PartialGradients<S>::head;
                if (!scratch.slots.is_touched(at)) {
                    scratch.slots.touched[static_cast<std::size_t>(at)] = 1;
                    std::fill_n(slot, scratch.slots.stride, S(0));
                }
                for (Index c = 0; c < channels; ++c) g_feature[c] += h->weight * g_pixel[c];
                const detail::PixelCotangent<T> g_here{{along(feature)}, g_alpha, g_depth};
                blend.take_vjp(*h, h->u, h->v, scene.splat(h->entry), g_here, behind, slot);
            }
        }
}

} // namespace rye
