// SPDX-License-Identifier: Apache-2.0
#include <rye/core/thread_pool.hpp>
#include <rye/interactive/redraw.hpp>

#include <limits>
#include <doctest/doctest.h>

#include <rye/core/bits.hpp>

#include "../support/scenes.hpp"

using namespace rye;
using namespace rye::test;

namespace {

template <class T>
void check_same(const Raster<T>& a, const Raster<T>& b) {
    CHECK(same_bits(a.feature.pixels, b.feature.pixels));
    CHECK(same_bits(a.alpha.pixels, b.alpha.pixels));
    CHECK(same_bits(a.depth.pixels, b.depth.pixels));
    CHECK(a.trace.non_finite == b.trace.non_finite);
}

/// Moves some columns of g: a few, a run of them, most; some out of view, some to NaN, some back.
template <class T>
std::vector<Index> shake(Gaussians<T>& g, const Gaussians<T>& home, int step) {
    const Random random{static_cast<std::uint64_t>(step), 3};
    std::vector<Index> changed;
    const double share = step % 4 == 0 ? 0.9 : step % 4 == 1 ? 0.02 : 0.2;
    std::uint64_t k = 0;
    for (Index i = 0; i < g.count(); ++i) {
        const bool run = step % 4 == 3 && i > g.count() / 3 && i < g.count() / 2;
        if (!run && random.uniform(k++) > share) continue;
        changed.push_back(i);
        g.mean.col(i) = home.mean.col(i);
        g.opacity(0, i) = home.opacity(0, i);
        const double what = random.uniform(k++);
        if (what < 0.1) g.opacity(0, i) = T(0);
        else if (what < 0.15) g.mean(0, i) = std::numeric_limits<T>::quiet_NaN();
        else if (what < 0.25) g.mean(0, i) += T(50);
        else if (what < 0.9)
            for (Index j = 0; j < 3; ++j) g.mean(j, i) += static_cast<T>(0.2 * random.normal(k++));
        if (what > 0.5) g.feature.col(i).setConstant(static_cast<T>(random.uniform(k++)));
        if (what > 0.7) g.scale.col(i) *= T(1.1);
    }
    return changed;
}

template <class A, class B, class T>
void follow(const B& backend, const Scenery<T>& s, int steps) {
    const Rasterizer<A> rasterizer;
    Redraw<B, A, T> live(backend, rasterizer);
    Gaussians<T> g = s.gaussians;
    VecX<T> background = s.background;
    live.draw(g, s.camera, background);
    check_same(live.raster(), rasterizer.forward(backend, g, s.camera, background));
    for (int step = 0; step < steps; ++step) {
        const std::vector<Index> changed = shake(g, s.gaussians, step);
        live.redraw(g, changed);
        CHECK(live.work().projected == static_cast<Index>(changed.size()));
        if (step == steps / 2) {
            background *= T(0.5);
            live.redraw_background(g, background);
        }
        check_same(live.raster(), rasterizer.forward(backend, g, s.camera, background));
    }
}

} // namespace

TEST_CASE_TEMPLATE("redraw: the bits of a whole render, over every backend and scalar", T, float,
                   double) {
    for (const Index channels : {3, 8}) {
        const Scenery<T> s = random_scene<T>(700, channels, 11);
        follow<Balanced>(XsimdBackend{}, s, 12);
        follow<Balanced>(ScalarBackend{}, s, 4);
        follow<Compatible3dgs>(XsimdBackend{}, s, 6);
        follow<Fast>(XsimdBackend{}, s, 6);
    }
}

TEST_CASE("redraw: the bits of a whole render, on hard scenes") {
    for (const Scenery<float>& s : hard_scenes<float>(3)) {
        INFO(s.name);
        follow<Balanced>(XsimdBackend{}, s, 5);
    }
}

TEST_CASE("redraw: the bits do not depend on the number of threads") {
    Scenery<float> s = random_scene<float>(2000, 8, 4, 0.03);
    s.camera.width = 150;
    s.camera.height = 120;
    for (const int threads : {1, 2, 3}) {
        ThreadPool pool(threads);
        follow<Balanced>(XsimdBackend{pool.threads()}, s, 5);
    }
}

TEST_CASE("redraw: only what changed is projected, only its tiles are blended") {
    Scenery<float> s = random_scene<float>(400, 3, 2, 0.01);
    s.camera.width = 160;
    s.camera.height = 160;
    s.camera.fx = s.camera.fy = 120;
    s.camera.cx = s.camera.cy = 80;
    Redraw<XsimdBackend<>, Balanced, float> live;
    live.draw(s.gaussians, s.camera, s.background);
    CHECK(live.work().blended == 100);
    live.redraw(s.gaussians, {});
    CHECK(live.work().projected == 0);
    CHECK(live.work().blended == 0);
    // One Gaussian alone, whose colour changes.
    s.gaussians.mean.col(7) << 0, 0, -1;
    live.draw(s.gaussians, s.camera, s.background);
    s.gaussians.feature.col(7).setConstant(0.25f);
    live.redraw(s.gaussians, std::vector<Index>{7});
    CHECK(live.work().projected == 1);
    CHECK(live.work().blended >= 1);
    CHECK(live.work().blended <= 9);
    check_same(live.raster(),
               Rasterizer<>().forward(XsimdBackend<>{}, s.gaussians, s.camera, s.background));
}

TEST_CASE("redraw: a tile that is full before the first change is not blended again") {
    Scenery<float> s = random_scene<float>(300, 3, 9, 0.5);
    s.gaussians.opacity.setConstant(1);
    s.gaussians.mean.row(2).array() = s.gaussians.mean.row(2).array().min(0.5f);
    s.gaussians.mean(2, 17) = 40;
    Redraw<XsimdBackend<>, Balanced, float> live;
    live.draw(s.gaussians, s.camera, s.background);
    s.gaussians.feature.col(17).setConstant(0.5f);
    live.redraw(s.gaussians, std::vector<Index>{17});
    CHECK(live.work().projected == 1);
    CHECK(live.work().blended == 0);
    check_same(live.raster(),
               Rasterizer<>().forward(XsimdBackend<>{}, s.gaussians, s.camera, s.background));
}

TEST_CASE("redraw: what does not fit is refused, and the next whole picture is right") {
    Scenery<float> s = random_scene<float>(50, 3, 3);
    Redraw<XsimdBackend<>, Balanced, float> live;
    CHECK_THROWS_AS(live.redraw(s.gaussians, std::vector<Index>{0}), Error);
    live.draw(s.gaussians, s.camera, s.background);
    const Scenery<float> other = random_scene<float>(51, 3, 3);
    CHECK_THROWS_AS(live.redraw(other.gaussians, std::vector<Index>{0}), Error);
    CHECK(live.bytes() > 0);

    Rasterizer<> strict;
    strict.accuracy.non_finite = NonFinite::fail;
    Redraw<XsimdBackend<>, Balanced, float> fails({}, strict);
    fails.draw(s.gaussians, s.camera, s.background);
    const Gaussians<float> good = s.gaussians;
    s.gaussians.mean(0, 4) = std::numeric_limits<float>::quiet_NaN();
    CHECK_THROWS_AS(fails.redraw(s.gaussians, std::vector<Index>{4}), Error);
    CHECK(!fails.drawn());
    fails.draw(good, s.camera, s.background);
    check_same(fails.raster(), strict.forward(XsimdBackend<>{}, good, s.camera, s.background));
}
