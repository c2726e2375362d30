// SPDX-License-Identifier: Apache-2.0
// A Gaussian at a pixel: the same formulas on numbers, vectors and duals, forward and reverse.
#include <rye/splat/blend.hpp>

#include <array>
#include <vector>

#include <doctest/doctest.h>

#include <rye/autodiff/dual.hpp>
#include <rye/core/random.hpp>
#include <rye/math/exponential.hpp>
#include <rye/splat/lanes/group.hpp>

#include "../support/array_lanes.hpp"

using namespace rye;
using namespace rye::test;

namespace {

struct Never : Balanced {
    static constexpr Stop stop_rule = Stop::never;
};
struct InclusiveFloor : Compatible3dgsFloor {
    static constexpr Stop stop_rule = Stop::inclusive;
};

constexpr int depth = 12;
using Draws = std::array<std::array<double, 5>, depth>;   ///< u, v, opacity, s, z

Draws draw(std::uint64_t seed) {
    const Random random{seed, 9};
    Draws d;
    std::uint64_t k = 0;
    for (auto& layer : d) {
        layer = {2.4 * random.uniform(k) - 1.2, 2.4 * random.uniform(k + 1) - 1.2,
                 0.2 + 0.8 * random.uniform(k + 2), random.uniform(k + 3), random.uniform(k + 4)};
        k += 5;
    }
    return d;
}

/// Inputs of a layer at a pixel.
template <class V>
struct Layer {
    V u, v, log2_opacity, cut, floor, colour, depth;
};
template <class V, class A>
Layer<V> layer_of(const A& a, const V& u, const V& v, const V& opacity, const V& s, const V& z) {
    using std::log2;
    using R = real_t<V>;
    V floor(R(0));
    if constexpr (A::has_floor) floor = V(static_cast<R>(a.alpha_floor)) * opacity;
    return {u, v, log2(opacity), log2(V(static_cast<R>(a.alpha_min)) + floor), floor, s, z};
}

/// Contributions of a pixel's layers, or of a group's pixels.
template <class V, class Pixels, class A>
std::vector<detail::Contribution<V>> walk(const A& a, const std::vector<Layer<V>>& layers, V& end) {
    const Blend<A, V, Pixels, Exp2Library> blend(a);
    std::vector<detail::Contribution<V>> all;
    end = V(real_t<V>(1));
    for (const Layer<V>& l : layers) {
        const V x = detail::less_square(detail::less_square(l.log2_opacity, l.u), l.v);
        all.push_back(blend.take(blend.coverage(x, l.cut, l.floor), end));
    }
    return all;
}

/// The plain loop, with skips and stops.
template <class V, class A>
std::vector<detail::Contribution<V>> walk_single(const A& a, const std::vector<Layer<V>>& layers,
                                                 V& end) {
    const Blend<A, V, SinglePixel, Exp2Library> blend(a);
    std::vector<detail::Contribution<V>> all(layers.size(),
                                             detail::Contribution<V>{{V(0), V(0)}, V(0), V(0)});
    end = V(1);
    for (std::size_t i = 0; i < layers.size(); ++i) {
        const Layer<V>& l = layers[i];
        const V x = detail::less_square(detail::less_square(l.log2_opacity, l.u), l.v);
        if (!blend.reaches(x, l.cut)) continue;
        const auto c = blend.take(blend.coverage(x, l.cut, l.floor), end);
        if (!c.taken) break;
        all[i] = c;
        if (!blend.open(end)) break;
    }
    return all;
}

template <class A>
void check_walks(A a) {
    a.stop = 0.05;                                  // some pixels saturate, others do not
    using V = ArrayLanes<double, 4>;
    for (std::uint64_t seed = 0; seed < 40; ++seed) {
        std::vector<Layer<V>> lanes(depth);
        std::array<std::vector<Layer<double>>, 4> layers;
        for (std::size_t lane = 0; lane < 4; ++lane) {
            const Draws d = draw(4 * seed + lane);
            for (std::size_t i = 0; i < depth; ++i) {
                layers[lane].push_back(
                    layer_of<double>(a, d[i][0], d[i][1], d[i][2], d[i][3], d[i][4]));
                const Layer<double>& l = layers[lane][i];
                Layer<V>& to = lanes[i];
                to.u.data.x[lane] = l.u, to.v.data.x[lane] = l.v;
                to.log2_opacity.data.x[lane] = l.log2_opacity, to.cut.data.x[lane] = l.cut;
                to.floor.data.x[lane] = l.floor;
            }
        }
        V lanes_end;
        const auto together = walk<V, detail::LanePixels>(a, lanes, lanes_end);
        for (std::size_t lane = 0; lane < 4; ++lane) {
            double grouped_end, single_end;
            const auto grouped = walk<double, detail::PixelGroup>(a, layers[lane], grouped_end);
            const auto single = walk_single<double>(a, layers[lane], single_end);
            CHECK(lanes_end.get(lane) == doctest::Approx(grouped_end).epsilon(1e-14));
            CHECK(std::abs(grouped_end) == doctest::Approx(single_end).epsilon(1e-13));
            for (std::size_t i = 0; i < depth; ++i) {
                const double w = grouped[i].weight;
                CHECK(together[i].weight.get(lane) == doctest::Approx(w).epsilon(1e-14));
                CHECK(single[i].weight == doctest::Approx(w).epsilon(1e-13));
            }
        }
    }
}

/// Reverse steps of a group of pixels against duals through single pixels, layer by layer.
template <class Pixels, class A>
void check_reverse(A a) {
    a.stop = 0.05;
    using D = Dual<double, 4>;                      // u, v, log o, depth
    const Blend<A, double, Pixels, Exp2Library> blend(a);
    const double background = 0.3, g_alpha = 0.7, g_depth = -0.4;
    for (std::uint64_t seed = 0; seed < 40; ++seed) {
        const Draws d = draw(seed);
        std::vector<Layer<double>> layers;
        for (const auto& x : d)
            layers.push_back(layer_of<double>(a, x[0], x[1], x[2], x[3], x[4]));
        double end;
        auto way = walk<double, detail::PixelGroup>(a, layers, end);
        if constexpr (Pixels::keeps_bell) way = walk_single<double>(a, layers, end);
        double behind = background;
        for (std::size_t i = depth; i-- > 0;) {
            std::array<double, 7> sum{};
            const detail::PixelCotangent<double> g{{layers[i].colour}, g_alpha, g_depth};
            if (way[i].weight > 0 || !Pixels::keeps_bell)
                blend.take_vjp(way[i], layers[i].u, layers[i].v, layers[i], g, behind, sum);
            std::vector<Layer<D>> moved;
            for (std::size_t j = 0; j < depth; ++j) {
                const bool here = i == j;
                const D u = here ? D::variable(d[j][0], 0) : D(d[j][0]);
                const D v = here ? D::variable(d[j][1], 1) : D(d[j][1]);
                const D share = here ? D::variable(1.0, 2) : D(1.0);
                const D z = here ? D::variable(d[j][4], 3) : D(d[j][4]);
                moved.push_back(layer_of<D>(a, u, v, share * D(d[j][2]), D(d[j][3]), z));
            }
            D dual_end;
            const auto hits = walk_single<D>(a, moved, dual_end);
            D value = dual_end * D(background) + D(g_alpha) * (D(1.0) - dual_end);
            for (std::size_t j = 0; j < depth; ++j)
                value += hits[j].weight * (moved[j].colour + D(g_depth) * moved[j].depth);
            // The exponent in natural units is -(u^2 + v^2) ln 2; sums are of g u and g v.
            CHECK(-2 * ln_2 * sum[0] == doctest::Approx(value.d[0]).epsilon(1e-9));
            CHECK(-2 * ln_2 * sum[1] == doctest::Approx(value.d[1]).epsilon(1e-9));
            CHECK(sum[5] == doctest::Approx(value.d[2]).epsilon(1e-9));
            CHECK(sum[6] == doctest::Approx(value.d[3]).epsilon(1e-9));
            CHECK(sum[2] + sum[4] ==
                  doctest::Approx(sum[0] * layers[i].u + sum[1] * layers[i].v).epsilon(1e-12));
            CHECK(sum[3] == doctest::Approx(sum[0] * layers[i].v).epsilon(1e-12));
        }
    }
}

} // namespace

TEST_CASE("blend: numbers, vectors and plain loops take the same of every layer") {
    check_walks(Balanced());
    check_walks(Exact64());
    check_walks(Never());
    check_walks(Compatible3dgs());
    check_walks(Compatible3dgsFloor());
    check_walks(InclusiveFloor());
}

TEST_CASE("blend: the step back is the adjoint of the step") {
    check_reverse<SinglePixel>(Balanced());
    check_reverse<detail::PixelGroup>(Balanced());
    check_reverse<detail::PixelGroup>(Never());
    check_reverse<SinglePixel>(Compatible3dgs());
    check_reverse<detail::PixelGroup>(Compatible3dgs());
    check_reverse<SinglePixel>(Compatible3dgsFloor());
    check_reverse<detail::PixelGroup>(Compatible3dgsFloor());
    check_reverse<detail::PixelGroup>(InclusiveFloor());
}

TEST_CASE("blend: a clamped alpha has a weight and no derivative but by what is behind") {
    Balanced a;
    a.alpha_max = 0.5;
    const Blend<Balanced, double, detail::PixelGroup, Exp2Library> group(a);
    const Blend<Balanced, double, SinglePixel, Exp2Library> single(a);
    double t = 1, s = 1;
    const auto g = group.take(group.coverage(-0.1, -9, 0), t);
    const auto c = single.take(single.coverage(-0.1, -9, 0), s);
    CHECK(g.alpha == 0.5);
    CHECK(c.alpha == 0.5);
    for (const bool one : {false, true}) {
        std::array<double, 7> sum{};
        double behind = 0.2;
        const detail::ColourCotangent<double> along{0.8};
        const Layer<double> layer{};
        if (one)
            single.take_vjp(c, 0.2, 0.1, layer, along, behind, sum);
        else
            group.take_vjp(g, 0.2, 0.1, layer, along, behind, sum);
        CHECK(behind == doctest::Approx(0.5));
        for (const double x : sum) CHECK(x == 0);
    }
}
