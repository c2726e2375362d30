// SPDX-License-Identifier: Apache-2.0
/// rye/splat/select_accuracy.hpp: the cheapest accuracy whose error on sampled tiles stays within a
/// bound. A ladder of Balanced's numbers is climbed from coarse to exact. On each rung one pixel of
/// every tile is compared with the exact rung; then whole tiles are: those whose pixel was worst,
/// and others drawn at random. The sample allows this statement about the picture: if n random
/// tiles all keep the bound, at most 3 / n of all tiles break it, with 95 % confidence.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <vector>

#include <rye/core/format.hpp>
#include <rye/core/random.hpp>
#include <rye/math/exponential.hpp>
#include <rye/splat/plain/forward.hpp>
#include <rye/splat/plain/stage.hpp>

namespace rye {

/// A rung of the ladder: numbers for the rules of Balanced.
struct AccuracyRung {
    const char* name;
    double alpha_min, stop, alpha_max;

    Balanced accuracy() const {
        Balanced a;
        a.alpha_min = alpha_min;
        a.stop = stop;
        a.alpha_max = alpha_max;
        return a;
    }
};

/// From coarse to exact, each about a tenth slower than the one before. The presets are among them.
inline constexpr std::array<AccuracyRung, 10> accuracy_ladder{{
    {"1/64", 1.0 / 64, 1e-3, 0.999},
    {"1/128", 1.0 / 128, 3e-4, 0.999},
    {"Fast", 1.0 / 255, 1e-4, 0.999},
    {"1/600", 1.0 / 600, 4e-5, 0.999},
    {"1/1200", 1.0 / 1200, 2e-5, 0.999},
    {"Balanced", 1.0 / 2550, 1e-5, 0.999},
    {"1/7500", 1.0 / 7500, 3e-6, 1},
    {"Tight", 1.0 / 25500, 1e-6, 1},
    {"1/255000", 1.0 / 255000, 1e-7, 1},
    {"Exact32", 1e-9, 1e-8, 1},
}};

namespace detail {

/// Settings of select_accuracy's samples.
struct SelectSettings {
    Index random_tiles = 64;   ///< drawn at random; all, if there are no more
    Index worst_tiles = 64;    ///< those whose pixel was worst
    double margin = 0.9;       ///< sampled errors must stay below this share of the bound
    std::uint64_t seed = 1;
};

} // namespace detail

/// The policy that select_accuracy chose, with the errors that it found.
struct SelectedAccuracy {
    Balanced accuracy;
    std::string name;          ///< rung's name
    bool met = false;          ///< false: even the exact rung may break the bound
    double sampled_error = 0;  ///< the largest on the sampled tiles, against the exact rung
    double rounding = 0;       ///< error of the exact rung itself, from T's rounding
    Index tiles = 0;           ///< sampled
    double failing_share = 1;  ///< largest share of tiles, with 95 % confidence
};

namespace detail {

/// A scene made ready for the walks of single pixels and tiles, by plain loops.
template <Backend B, Real T>
struct TileSample {
    const B& backend;
    const Gaussians<T>& g;
    const Pinhole<T>& camera;
    const VecX<T>& background;
    Balanced accuracy;
    RasterScratch<T> scratch = {};
    RasterTrace<T> trace = {};

    void prepare() {
        const SplatInput in{view_of(g), camera, accuracy};
        scratch.shape(g.count());
        for_chunks(backend.threads, g.count(), 1024, [&](Index b, Index e, Index) {
            project_range(in, {b, e}, scratch);
        });
        bin_and_sort(backend, in, scratch, trace);
    }
    Scene<T> scene() const {
        return {trace, g, background, camera.cx, camera.cy, camera.width, camera.height};
    }
    VecX<T> pixel(const Scene<T>& s, Index tile, int x, int y) const {
        VecX<T> sum = VecX<T>::Zero(g.channels());
        const T end = walk_pixel(s, accuracy, {tile, x, y}, [&](const PixelContribution<T>& h) {
            const T* feature = s.feature_of(h.entry);
            for (Index c = 0; c < sum.size(); ++c) sum[c] += h.weight * feature[c];
        });
        return sum + end * background;
    }
};

/// Returns the largest difference of two samples in one tile; `stride` leaves pixels out.
template <class Sample>
double tile_gap(const Sample& a, const Sample& b, Index tile, int first, int stride) {
    const auto sa = a.scene(), sb = b.scene();
    double worst = 0;
    for (int y = sa.top(tile) + first; y < sa.bottom(tile); y += stride)
        for (int x = sa.left(tile) + first; x < sa.right(tile); x += stride) {
            const double d = static_cast<double>(
                (a.pixel(sa, tile, x, y) - b.pixel(sb, tile, x, y)).cwiseAbs().maxCoeff());
            worst = d <= worst ? worst : d;
        }
    return worst;
}

} // namespace detail

/// Returns the cheapest policy that keeps `bound`, the largest absolute error of any channel of any
/// pixel against every Gaussian at every pixel. Use it as Rasterizer{chosen.accuracy}.
template <Real T, Backend B>
SelectedAccuracy select_accuracy(const B& backend, const Gaussians<T>& g, const Pinhole<T>& camera,
                                 const VecX<T>& background, double bound,
                                 const detail::SelectSettings& settings = {}) {
    using Sample = detail::TileSample<B, T>;
    require(bound > 0, "select_accuracy", "got a bound of ", bound, ", expected a positive one");
    detail::check_shapes("select_accuracy", g);
    const AccuracyRung& last = accuracy_ladder.back();
    SelectedAccuracy chosen{last.accuracy(), last.name};
    const double size = std::max(1.0, g.feature.size() > 0
                                          ? static_cast<double>(g.feature.cwiseAbs().maxCoeff())
                                          : 0.0);
    const bool single = sizeof(T) == 4;
    chosen.rounding = single ? 5e-5 * size : 1e-7 * size;
    Sample exact{backend, g, camera, background, last.accuracy()};
    exact.prepare();
    const Index all = exact.trace.lists.tiles(), n = std::min(all, settings.random_tiles);
    std::vector<double> probe(static_cast<std::size_t>(all));
    std::vector<Index> order(static_cast<std::size_t>(all));
    const auto at = [](auto& v, Index i) -> auto& { return v[static_cast<std::size_t>(i)]; };

    for (std::size_t rung = 0; rung + 1 < accuracy_ladder.size(); ++rung) {
        Sample coarse{backend, g, camera, background, accuracy_ladder[rung].accuracy()};
        coarse.prepare();
        for_chunks(backend.threads, all, 16, [&](Index b, Index e, Index) {
            for (Index t = b; t < e; ++t)
                at(probe, t) =
                    detail::tile_gap(exact, coarse, t, detail::tile_edge / 2, detail::tile_edge);
        });
        for (Index t = 0; t < all; ++t) at(order, t) = t;
        std::stable_sort(order.begin(), order.end(),
                         [&](Index a, Index b) { return at(probe, a) > at(probe, b); });
        const Index worst = std::min(all, settings.worst_tiles);
        std::vector<Index> tiles(order.begin(), order.begin() + worst);
        // Random ones without repetition: the first n of a shuffle.
        std::vector<Index> shuffled(order);
        std::sort(shuffled.begin(), shuffled.end());
        const Random random{settings.seed, rung};
        for (Index i = 0; i < n; ++i)
            std::swap(at(shuffled, i),
                      at(shuffled, i + random.below(static_cast<std::uint64_t>(i), all - i)));
        tiles.insert(tiles.end(), shuffled.begin(), shuffled.begin() + n);
        std::vector<double> gaps(tiles.size());
        for_chunks(backend.threads, static_cast<Index>(tiles.size()), 1,
                   [&](Index b, Index e, Index) {
                       for (Index i = b; i < e; ++i)
                           at(gaps, i) = detail::tile_gap(exact, coarse, at(tiles, i), 0, 1);
                   });
        double gap = 0;
        for (const double d : gaps) gap = d <= gap ? gap : d;
        for (const double d : probe) gap = d <= gap ? gap : d;
        if (!(gap + chosen.rounding <= settings.margin * bound)) continue;
        chosen.accuracy = accuracy_ladder[rung].accuracy();
        chosen.name = accuracy_ladder[rung].name;
        chosen.sampled_error = gap;
        chosen.tiles = static_cast<Index>(tiles.size());
        chosen.failing_share =
            n == all ? 0 : std::min(1.0, 3.0 / static_cast<double>(std::max<Index>(n, 1)));
        chosen.met = true;
        return chosen;
    }
    chosen.met = chosen.rounding <= bound;
    chosen.failing_share = chosen.met ? 0 : 1;
    return chosen;
}

} // namespace rye
