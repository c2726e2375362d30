// SPDX-License-Identifier: Apache-2.0
// Views of a host program's records: no number is copied, which addresses show, and pictures and
// gradients are those of the same Gaussians in arrays of their own, bit for bit, on every backend.
#include <rye/splat/lanes.hpp>

#include <vector>

#include <doctest/doctest.h>

#include <rye/splat/jvp.hpp>

#include "../support/scenes.hpp"

using namespace rye;
using namespace rye::test;

namespace {

/// A vertex as a renderer may hold it: other fields between those that are drawn.
struct Vertex {
    float rgb[3];
    float padding;
    float position[3];
    float opacity;
    float rotation[4];
    float id;
    float scale[3];
};

std::vector<Vertex> interleaved(const Gaussians<float>& g) {
    std::vector<Vertex> all(static_cast<std::size_t>(g.count()));
    for (Index i = 0; i < g.count(); ++i) {
        Vertex& v = all[static_cast<std::size_t>(i)];
        for (int k = 0; k < 3; ++k) {
            v.rgb[k] = g.feature(k, i);
            v.position[k] = g.mean(k, i);
            v.scale[k] = g.scale(k, i);
        }
        for (int k = 0; k < 4; ++k) v.rotation[k] = g.rotation(k, i);
        v.opacity = g.opacity(0, i);
        v.padding = v.id = NAN; // never read
    }
    return all;
}

GaussianView<float> view_of(const std::vector<Vertex>& all) {
    constexpr Index stride = stride_in<float, Vertex>();
    const Vertex& first = all.front();
    GaussianView<float> v;
    v.mean = {first.position, stride};
    v.rotation = {first.rotation, stride};
    v.scale = {first.scale, stride};
    v.opacity = {&first.opacity, stride};
    v.feature = first.rgb;
    v.stride = stride;
    v.rows = 3;
    v.size = static_cast<Index>(all.size());
    return v;
}

bool same(const Gaussians<float>& a, const Gaussians<float>& b) {
    bool equal = true;
    Gaussians<float>::fields(
        [&](const std::string&, const auto& x, const auto& y) { equal &= x == y; }, a, b);
    return equal;
}

template <class A, class B>
void check_equal(const B& backend, const Scenery<float>& s, const A& accuracy) {
    const std::vector<Vertex> vertices = interleaved(s.gaussians);
    const GaussianView<float> v = view_of(vertices);
    const Rasterizer<A> rasterizer{accuracy};
    const auto a = rasterizer.forward(backend, s.gaussians, s.camera, s.background);
    const auto b = rasterizer.forward(backend, v, s.camera, s.background);
    CHECK(a.feature.pixels.maxCoeff() > 0.1f);
    CHECK(a.feature.pixels == b.feature.pixels);
    CHECK(a.alpha.pixels == b.alpha.pixels);
    const Columns<float> w = noise<float>(3, a.feature.size(), 21);
    CHECK(same(rasterizer.vjp(backend, s.gaussians, s.camera, s.background, a, w),
               rasterizer.vjp(backend, v, s.camera, s.background, b, w)));
}

} // namespace

TEST_CASE("strided view: it points into the records themselves") {
    const auto s = random_scene<float>(50, 3, 8);
    const std::vector<Vertex> vertices = interleaved(s.gaussians);
    const GaussianView<float> v = view_of(vertices).columns(10, 20);
    for (Index i = 0; i < v.count(); ++i) {
        const Vertex& record = vertices[static_cast<std::size_t>(10 + i)];
        CHECK(v.mean(i) == record.position);
        CHECK(v.rotation(i) == record.rotation);
        CHECK(v.scale(i) == record.scale);
        CHECK(v.opacity(i) == &record.opacity);
        CHECK(v.feature_of(i) == record.rgb);
    }
    CHECK(same(copy_of(view_of(vertices)), s.gaussians));
    const GaussianView<float> packed = s.gaussians;
    CHECK(packed.mean(7) == s.gaussians.mean.data() + 21);
    CHECK(packed.opacity(7) == s.gaussians.opacity.data() + 7);
}

TEST_CASE("strided view: pictures and gradients have the same bits, by lanes and plain loops") {
    const auto s = random_scene<float>(400, 3, 9);
    check_equal(XsimdBackend{}, s, Balanced{});
    check_equal(ScalarBackend{}, s, Balanced{});
    check_equal(XsimdBackend{}, s, Compatible3dgs{});
}

TEST_CASE("strided view: arrays read backwards") {
    const auto s = random_scene<float>(60, 3, 10);
    Gaussians<float> reversed = s.gaussians;
    Gaussians<float>::fields(
        [](const std::string&, Columns<float>& a) { a = a.rowwise().reverse().eval(); }, reversed);
    GaussianView<float> v = s.gaussians;
    v.mean = {v.mean(59), -3};
    v.rotation = {v.rotation(59), -4};
    v.scale = {v.scale(59), -3};
    v.opacity = {v.opacity(59), -1};
    v.feature = v.feature_of(59);
    v.stride = -3;
    CHECK(same(copy_of(v), reversed));
}

TEST_CASE("default backend: the lanes' picture and gradient, and the caller's memory") {
    const auto s = random_scene<float>(200, 3, 11);
    const Rasterizer rasterizer;
    const auto a = rasterizer.forward(XsimdBackend{}, s.gaussians, s.camera, s.background);
    const auto b = rasterizer.forward(s.gaussians, s.camera, s.background);
    CHECK(a.feature.pixels == b.feature.pixels);
    Raster<float> c;
    rasterizer.forward_into(s.gaussians, s.camera, s.background, c);
    CHECK(a.feature.pixels == c.feature.pixels);
    const Columns<float> w = noise<float>(3, a.feature.size(), 22);
    CHECK(same(rasterizer.vjp(XsimdBackend{}, s.gaussians, s.camera, s.background, a, w),
               rasterizer.vjp(s.gaussians, s.camera, s.background, b, w)));
    static_assert(std::is_same_v<DefaultBackend<float>, XsimdBackend<>>);
}
