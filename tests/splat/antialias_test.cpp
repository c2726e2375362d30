// SPDX-License-Identifier: Apache-2.0
// Antialiasing modes none, dilate, mip: renders and their gradients.
#include <rye/splat/lanes.hpp>

#include <doctest/doctest.h>

#include "../support/render_law.hpp"

using namespace rye;

namespace {

struct Mip : Exact64 {
    static constexpr Antialias antialias = Antialias::mip;
};
struct Unfiltered : Exact64 {
    static constexpr Antialias antialias = Antialias::none;
};
struct Balance : Balanced {
    static constexpr Antialias antialias = Antialias::mip;
};
struct Undilated : Exact64 {
    constexpr Undilated() { dilation = 0; }
};
struct UndilatedMip : Mip {
    constexpr UndilatedMip() { dilation = 0; }
};

/// Gaussians from a twentieth of a pixel to several.
Gaussians<double> specks(Index n) {
    const Random random{5, 0};
    Gaussians<double> g(n, 3);
    std::uint64_t k = 0;
    const auto draw = [&] { return 2 * random.uniform(k++) - 1; };
    for (Index i = 0; i < n; ++i) {
        for (Index a = 0; a < 3; ++a) g.mean(a, i) = 0.4 * draw();
        for (Index a = 0; a < 4; ++a) g.rotation(a, i) = draw();
        for (Index a = 0; a < 3; ++a) g.scale(a, i) = 0.02 * std::exp(1.5 * draw() - 1);
        g.opacity(0, i) = 0.5 + 0.4 * draw();
        for (Index a = 0; a < 3; ++a) g.feature(a, i) = 0.5 + 0.5 * draw();
    }
    return g;
}

Pinhole<double> camera() {
    Pinhole<double> c;
    c.fx = c.fy = 60, c.cx = 15.3, c.cy = 12.1;
    c.width = 30, c.height = 25;
    c.camera_from_world.translation = Vec3<double>(0, 0, 2);
    return c;
}

template <class B, class A, class T>
Raster<T> draw(const Gaussians<T>& g, const Pinhole<T>& c) {
    return Rasterizer<A>{}.forward(B{}, g, c, VecX<T>(VecX<T>::Zero(3)));
}

double most(const Columns<double>& a, const Columns<double>& b) {
    return (a - b).cwiseAbs().maxCoeff();
}

} // namespace

TEST_CASE("mip draws dilated Gaussians of the opacity that they keep; none is no dilation") {
    using B = ScalarBackend<>;
    const Gaussians<double> g = specks(40);
    const Pinhole<double> c = camera();
    Gaussians<double> kept = g;
    const Projector<double> lens(c, Exact64{}.frustum_margin, Exact64{}.dilation);
    for (Index i = 0; i < g.count(); ++i)
        kept.opacity(0, i) *=
            project<Antialias::mip>(detail::load_shape(view_of(g), i), lens).share;
    const Columns<double> mip = draw<B, Mip>(g, c).feature.pixels;
    CHECK(most(mip, draw<B, Exact64>(kept, c).feature.pixels) < 1e-13);
    CHECK(most(mip, draw<B, Exact64>(g, c).feature.pixels) > 0.05);
    const Columns<double> none = draw<B, Unfiltered>(g, c).feature.pixels;
    CHECK(none == draw<B, Undilated>(g, c).feature.pixels);
    CHECK(none == draw<B, UndilatedMip>(g, c).feature.pixels);  // neutral: share is 1
    CHECK(most(none, mip) > 0.01);
}

TEST_CASE("mip: a large Gaussian is drawn as it was") {
    using B = ScalarBackend<>;
    Gaussians<double> g = specks(6);
    g.scale.setConstant(50.0);
    const Pinhole<double> c = camera();
    CHECK(most(draw<B, Mip>(g, c).feature.pixels, draw<B, Exact64>(g, c).feature.pixels) < 1e-6);
}

TEST_CASE("mip keeps the light of a speck when the picture grows; dilation does not") {
    using B = ScalarBackend<>;
    Gaussians<double> g = specks(1);
    g.mean.setZero();
    g.scale.setConstant(0.003);  // a tenth of a pixel
    const auto light = [&](auto policy, double k) {  // in units of the world
        Pinhole<double> c = camera();
        c.fx *= k, c.fy *= k, c.cx *= k, c.cy *= k;
        c.width = int(k * c.width), c.height = int(k * c.height);
        return draw<B, decltype(policy)>(g, c).alpha.pixels.sum() / (k * k);
    };
    CHECK(light(Mip{}, 2) == doctest::Approx(light(Mip{}, 1)).epsilon(1e-3));
    CHECK(light(Mip{}, 4) == doctest::Approx(light(Mip{}, 1)).epsilon(1e-3));
    CHECK(light(Exact64{}, 2) < 0.5 * light(Exact64{}, 1));
}

TEST_CASE("mip: the render's vjp is the transpose of its duals; lanes agree with the plain walk") {
    using B = ScalarBackend<>;
    const Gaussians<double> g = specks(30);
    const Pinhole<double> c = camera();
    const test::Scenery<double> s{"specks", g, c, VecX<double>::Zero(3)};
    CHECK(test::render_law_gap<B>(s, c, Mip{}, 6) < 1e-11);

    Gaussians<float> f;
    convert_fields(f, g, [](double x) { return float(x); });
    const Pinhole<float> cf = c.cast<float>();
    using X = XsimdBackend<>;
    const Raster<float> lanes = draw<X, Balance>(f, cf), plain = draw<B, Balance>(f, cf);
    CHECK((lanes.feature.pixels - plain.feature.pixels).cwiseAbs().maxCoeff() < 1e-4f);
    const Columns<float> wf = test::noise<float>(3, lanes.feature.size(), 6);
    Gaussians<float> gx, gs;
    RasterScratch<float> scratch;
    const VecX<float> black = VecX<float>::Zero(3);
    const Rasterizer<Balance> balance;
    balance.vjp_into(X{}, f, cf, black, lanes, RasterCotangent<float>{wf}, gx, &scratch);
    balance.vjp_into(B{}, f, cf, black, plain, RasterCotangent<float>{wf}, gs, &scratch);
    CHECK((gx.scale - gs.scale).norm() < 1e-3f * gs.scale.norm());
    CHECK((gx.mean - gs.mean).norm() < 1e-3f * gs.mean.norm());
}
