// SPDX-License-Identifier: Apache-2.0
// Outputs besides features: leaving out depth changes no other bit and takes no memory, and
// contributors are those of weights summed by hand.
#include <rye/splat/outputs.hpp>

#include <doctest/doctest.h>

#include <rye/core/random.hpp>
#include <rye/splat/lanes.hpp>

using namespace rye;

namespace {

using Lean = FeaturesOnly<Balanced>;
static_assert(std::same_as<FeaturesOnly<Lean>, Lean>);
using Picking = Drawing<Balanced, Outputs{.depth = true, .contributor = true}>;
using PickingExactly = Drawing<Exact32, Outputs{.depth = false, .contributor = true}>;

static_assert(sizeof(detail::OutputImages<float, Outputs{false, false}>) <= 2);
static_assert(sizeof(Raster<float, Outputs{false, false}>) + 2 * sizeof(Image<float>) <=
              sizeof(Raster<float, Outputs{true, true}>));

template <class T>
struct Blobs {
    Gaussians<T> gaussians;
    Pinhole<T> camera;
    VecX<T> background;

    explicit Blobs(Index channels)
        : gaussians(300, channels), background(VecX<T>::Constant(channels, T(0.25))) {
        const Random random{8, 0};
        std::uint64_t k = 0;
        const auto draw = [&] { return static_cast<T>(2 * random.uniform(k++) - 1); };
        for (Index i = 0; i < gaussians.count(); ++i) {
            for (Index a = 0; a < 3; ++a) gaussians.mean(a, i) = T(0.3) * draw();
            for (Index a = 0; a < 4; ++a) gaussians.rotation(a, i) = draw();
            for (Index a = 0; a < 3; ++a) gaussians.scale(a, i) = T(0.02) * std::exp(draw());
            gaussians.opacity(0, i) = T(0.5) + T(0.45) * draw();
            for (Index a = 0; a < channels; ++a) gaussians.feature(a, i) = draw();
        }
        camera.fx = camera.fy = T(90), camera.cx = T(30.5), camera.cy = T(24.5);
        camera.width = 70, camera.height = 49;      // its last tiles are cut, its left ones empty
        camera.camera_from_world.translation = Vec3<T>(T(0.1), T(0), T(1.5));
    }
};

/// Index of the largest weight of each pixel, and its margin.
template <class A, class T>
std::pair<std::vector<std::uint32_t>, std::vector<T>> by_hand(const Blobs<T>& s,
                                                              const RasterTrace<T>& trace) {
    const Scene<T> scene{trace, s.gaussians, s.background, s.camera.cx, s.camera.cy,
                         s.camera.width, s.camera.height};
    const auto pixels = static_cast<std::size_t>(s.camera.width * s.camera.height);
    std::vector<std::uint32_t> which(pixels, no_contributor);
    std::vector<T> lead(pixels, T(1));
    for (Index t = 0; t < trace.lists.tiles(); ++t)
        for (int y = scene.top(t); y < scene.bottom(t); ++y)
            for (int x = scene.left(t); x < scene.right(t); ++x) {
                std::vector<std::pair<T, std::uint32_t>> weights;
                walk_pixel(scene, A{}, {t, x, y}, [&](const PixelContribution<T>& h) {
                    weights.push_back({h.weight, scene.member(h.entry).source});
                });
                if (weights.empty()) continue;
                std::stable_sort(weights.begin(), weights.end(),
                                 [](const auto& a, const auto& b) { return a.first > b.first; });
                const auto p = static_cast<std::size_t>(scene.pixel(x, y));
                which[p] = weights[0].second;
                if (weights.size() > 1) lead[p] = weights[0].first - weights[1].first;
            }
    return {which, lead};
}

template <class B, class A, class T>
void check_contributors(Index channels) {
    const Blobs<T> s(channels);
    const auto r = Rasterizer<A>{}.forward(B{}, s.gaussians, s.camera, s.background);
    const auto [which, lead] = by_hand<A>(s, r.trace);
    Index wrong = 0, some = 0, none = 0;
    for (std::size_t p = 0; p < which.size(); ++p) {
        const std::uint32_t drawn = r.contributor.pixels(0, static_cast<Index>(p));
        ++(drawn == no_contributor ? none : some);
        if (drawn != which[p] && lead[p] > T(1e-5)) ++wrong;
    }
    CHECK(wrong == 0);
    CHECK(some > 1000);
    CHECK(none > 100);
}

template <class B, class T>
void check_lean(Index channels) {
    const Blobs<T> s(channels);
    const Rasterizer<Balanced> whole;
    const Rasterizer<Lean> lean;
    const auto a = whole.forward(B{}, s.gaussians, s.camera, s.background);
    const auto b = lean.forward(B{}, s.gaussians, s.camera, s.background);
    CHECK(a.feature.pixels == b.feature.pixels);
    CHECK(a.alpha.pixels == b.alpha.pixels);
    const Columns<T> g = a.feature.pixels.array().sin();
    const Gaussians<T> da = whole.vjp(B{}, s.gaussians, s.camera, s.background, a, g);
    const Gaussians<T> db = lean.vjp(B{}, s.gaussians, s.camera, s.background, b, g);
    CHECK(da.mean == db.mean);
    CHECK(da.feature == db.feature);
    const Columns<T> g_depth = Columns<T>::Ones(1, a.depth.size());
    CHECK_NOTHROW(whole.vjp(B{}, s.gaussians, s.camera, s.background, a, g, nullptr, &g_depth));
    CHECK_THROWS_WITH_AS(
        lean.vjp(B{}, s.gaussians, s.camera, s.background, b, g, nullptr, &g_depth),
        doctest::Contains("the policy's outputs have no depth"), Error);
}

} // namespace

TEST_CASE("outputs: without depth everything else is as with it, to the bit") {
    check_lean<ScalarBackend<>, double>(3);
    check_lean<XsimdBackend<>, float>(3);
    check_lean<XsimdBackend<>, float>(5);
    check_lean<XsimdBackend<>, double>(1);
}

TEST_CASE("outputs: a pixel's contributor is the Gaussian of its largest weight") {
    check_contributors<ScalarBackend<>, Picking, float>(3);
    check_contributors<ScalarBackend<>, PickingExactly, double>(3);
    check_contributors<XsimdBackend<>, Picking, float>(3);
    check_contributors<XsimdBackend<>, Picking, float>(5);
    check_contributors<XsimdBackend<>, PickingExactly, float>(4);
    check_contributors<XsimdBackend<>, PickingExactly, double>(3);
}
