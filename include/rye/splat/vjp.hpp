// SPDX-License-Identifier: Apache-2.0
/// rye/splat/vjp.hpp: the reverse pixel walk. With s_i = <cotangent, contribution i> and b_i the
/// same for all that lies behind i, composited from the background forward,
///     d/d alpha_i = T_i (s_i - b_i),   b_{i-1} = b_i + alpha_i (s_i - b_i),
/// which neither divides by 1 - alpha nor subtracts large sums: it is 0 where a Gaussian has the
/// colour of what is behind it. T_i is the stored prefix of the walk that is repeated here.
#pragma once

#include <rye/splat/forward.hpp>

namespace rye {

/// Adds the gradients of one tile's pixels to the slots of its entries, in the order of pixels.
/// Slots may be of a wider type S than what is added to them.
template <class A, class T, class S>
void blend_tile_vjp(const Scene<T>& scene, const A& accuracy, const RasterCotangent<T>& g,
                    Index tile, RasterScratch<S>& scratch, std::vector<Hit<T>>& hits) {
    const Index channels = scene.feature.rows();
    for (int y = scene.top(tile); y < scene.bottom(tile); ++y)
        for (int x = scene.left(tile); x < scene.right(tile); ++x) {
            hits.clear();
            walk_pixel(scene, accuracy, tile, x, y, [&](const Hit<T>& h) { hits.push_back(h); });
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
                S* const g_feature = slot + Slots<S>::head;
                if (!scratch.slots.is_touched(at)) {
                    scratch.slots.touched[static_cast<std::size_t>(at)] = 1;
                    std::fill_n(slot, scratch.slots.stride, S(0));
                }
                const T weight = h->transmittance * h->alpha;
                for (Index c = 0; c < channels; ++c) g_feature[c] += weight * g_pixel[c];
                const T extra = g_alpha + g_depth * scene.splat(h->entry).depth;
                const T more = (along(feature) - behind) + extra;
                behind += h->alpha * more;
                const T g_raw = h->transmittance * more;                  // d / d alpha
                const T g_exponent = g_raw * h->bell;
                const T gu = g_exponent * h->u, gv = g_exponent * h->v;
                slot[0] += gu;
                slot[1] += gv;
                slot[2] += gu * h->u;
                slot[3] += gu * h->v;
                slot[4] += gv * h->v;
                // o d alpha / d o; bell is 0, and so is this, where alpha is clamped.
                const T floor = scene.splat(h->entry).floor;
                slot[5] += g_exponent - select(h->bell > T(0), T(g_raw * floor), T(0));
                slot[6] += weight * g_depth;
            }
        }
}

} // namespace rye
