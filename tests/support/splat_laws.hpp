// SPDX-License-Identifier: Apache-2.0
/// tests/support/splat_laws.hpp: laws of the kernels in lanes, for any width: images against every
/// Gaussian at every pixel, gradients against plain loops in double and against duals. Included
/// once by the unit of each width, which names its backends.
#pragma once

#include <memory>

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>
#include <rye/splat/lanes/forward.hpp>
#include <rye/splat/lanes/stage.hpp>
#include <rye/splat/lanes/vjp.hpp>

#include "splat_reference.hpp"

namespace rye::test {

/// The steps of Rasterizer in lanes, with the kernel for C few channels or, for C = 0, for any
/// number of them, selected at compile time instead of by the number of channels.
template <class B, class A, class T>
struct Walks {
    using V = typename B::template batch<T>;
    /// The rules that the steps before and after the kernels depend on.
    using Stage = std::conditional_t<
        A::support == Support::ellipse, Balanced,
        std::conditional_t<A::has_floor, Compatible3dgsFloor, Compatible3dgs>>;

    const Scenery<T>& s;
    A accuracy;
    RasterScratch<T> scratch = {};
    Raster<T, A::outputs> r = {};

    Walks(const Scenery<T>& scenery, const A& rules) : s(scenery), accuracy(rules) {
        const Index n = s.gaussians.count();
        scratch.shape(n);
        const SplatInput in{view_of(s.gaussians), s.camera, stage()};
        project_range_lanes<V>(in, {0, n}, scratch);
        bin_and_sort(ScalarBackend<Serial>{}, in, scratch, r.trace);
        shape(r.feature, s.gaussians.channels());
        shape(r.alpha, 1);
        if constexpr (A::outputs.depth) shape(r.depth, 1);
        if constexpr (A::outputs.contributor) shape(r.contributor, 1);
        r.trace.used.resize(static_cast<std::size_t>(r.trace.lists.tiles()));
    }
    template <int C>
    void forward() {
        const auto canvas = std::make_unique<detail::LaneCanvas<V>>();
        detail::blend_tiles_lanes<V, C>(
            scene(), accuracy, detail::DrawnTiles().part(0, r.trace.lists.tiles()), r, *canvas);
    }
    template <int C, bool Extra>
    Gaussians<T> reverse(const Weights<T>& w) {
        const Index n = s.gaussians.count();
        scratch.slots.shape(r.trace.lists.entries(), s.gaussians.channels());
        const auto tape = std::make_unique<detail::LaneTape<V>>();
        const RasterCotangent<T> g{w.feature, Extra ? &w.alpha : nullptr,
                                   Extra ? &w.depth : nullptr};
        for (Index t = 0; t < r.trace.lists.tiles(); ++t)
            detail::blend_tile_vjp_lanes<V, C, Extra>(scene(), accuracy, {g, t}, scratch, *tape);
        detail::LaneSums<V> sums;
        Gaussians<T> out(n, s.gaussians.channels());
        const SplatInput in{view_of(s.gaussians), s.camera, stage()};
        detail::project_vjp_range_lanes<V>(in, {r.trace, scratch.slots}, {0, n}, out, sums);
        return out;
    }

  private:
    const Stage& stage() const { return accuracy; }
    Scene<T> scene() const {
        return {r.trace, s.gaussians, s.background, s.camera.cx, s.camera.cy,
                s.camera.width, s.camera.height};
    }
    template <class X>
    void shape(Image<X>& image, Index channels) const {
        image.width = s.camera.width;
        image.height = s.camera.height;
        image.pixels.resize(channels, image.size());
    }
};

/// Numbers around multiples of every width.
inline constexpr int awkward[] = {1, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 32, 33};

/// A cloud that fills an image of this size.
template <class T>
Scenery<T> sized_scene(int width, int height, Index channels, std::uint64_t seed) {
    Scenery<T> s = random_scene<T>(40, channels, seed, 0.12);
    s.camera.width = width;
    s.camera.height = height;
    s.camera.fx = s.camera.fy = static_cast<T>(4 + 1.4 * std::max(width, height));
    s.camera.cx = static_cast<T>(0.45 * width);
    s.camera.cy = static_cast<T>(0.55 * height);
    s.gaussians.opacity.array() = T(0.3) + T(0.65) * s.gaussians.opacity.array();
    return s;
}

/// Calls f of a scene for each number of channels, each of another size; then of each size.
template <class T, class F>
void each_awkward_scene(const F& f) {
    constexpr std::size_t n = std::size(awkward);
    for (std::size_t i = 0; i < n; ++i) {
        f(sized_scene<T>(awkward[(i + 4) % n], awkward[(i + 9) % n], awkward[i], i));
        f(sized_scene<T>(awkward[i], awkward[(i + 6) % n], 1 + Index(i % 4), 50 + i));
    }
}

/// The largest difference of images from the truth; depths are of the order of 3.
template <class Images, class Raster>
double gap(const Raster& r, const Images& truth) {
    const auto most = [](const auto& a, const auto& b) {
        const Columns<double> off = a.pixels.template cast<double>() - b.pixels;
        return off.size() == 0 ? 0.0 : off.cwiseAbs().maxCoeff();
    };
    return std::max({most(r.feature, truth.feature), most(r.alpha, truth.alpha),
                     most(r.depth, truth.depth) / 4});
}

/// The largest relative difference of a gradient's fields.
template <class T>
double gap(const Gaussians<T>& a, const Gaussians<double>& b) {
    double worst = 0;
    Gaussians<double> wide;
    convert_fields(wide, a, [](T x) { return static_cast<double>(x); });
    Gaussians<double>::fields(
        [&](const std::string&, const Columns<double>& x, const Columns<double>& y) {
            const double off = (x - y).norm() / (y.norm() + 1e-9);
            worst = off <= worst ? worst : off;              // NaN is the largest
        },
        wide, b);
    return worst;
}

template <class B, int C, class T>
void check_image(const Scenery<T>& s, const OracleImages& expected, double bound) {
    Walks<B, Balanced, T> walks(s, Balanced(Exact32()));
    walks.template forward<C>();
    CHECK(gap(walks.r, expected) < bound);
}

TEST_CASE_TEMPLATE_DEFINE("widths: images of every size and number of channels are the truth", B,
                          width_images) {
    each_awkward_scene<float>([](const Scenery<float>& s) {
        CAPTURE(s.camera.width);
        CAPTURE(s.camera.height);
        CAPTURE(s.gaussians.channels());
        const OracleImages expected = truth(s);
        check_image<B, 0>(s, expected, 5e-5);
        switch (s.gaussians.channels()) {
        case 1: check_image<B, 1>(s, expected, 5e-5); break;
        case 3: check_image<B, 3>(s, expected, 5e-5); break;
        case 4: check_image<B, 4>(s, expected, 5e-5); break;
        case 8: check_image<B, 8>(s, expected, 5e-5); break;
        default: break;
        }
    });
    each_awkward_scene<double>([](const Scenery<double>& s) {
        Walks<B, Balanced, double> walks(s, Balanced(Exact64()));
        walks.template forward<0>();
        CHECK(gap(walks.r, truth(s)) < 1e-11);
    });
}

TEST_CASE_TEMPLATE_DEFINE("widths: hard scenes are the truth", B, width_hard_scenes) {
    for (const Index channels : {3, 9})
        for (const auto& s : hard_scenes<float>(channels)) {
            CAPTURE(s.name);
            // Float exponents of a needle of sigma px are uncertain by u sigma / sqrt(dilation).
            const double needle = s.name == "needles of 300 px" || s.name == "huge" ? 3e-4 : 0;
            const OracleImages expected = truth(s);
            check_image<B, 0>(s, expected, 5e-5 + needle);
            if (channels == 3) check_image<B, 3>(s, expected, 5e-5 + needle);
        }
}

/// The image of a preset against the truth.
template <class B, class A>
double preset_gap(const Scenery<float>& s, const OracleImages& expected, const A& accuracy) {
    Walks<B, A, float> walks(s, accuracy);
    walks.template forward<0>();
    return gap(walks.r, expected);
}

/// The image of rules that are not the oracle's against the plain loops'.
template <class B, class A>
double plain_gap(const Scenery<float>& s, const A& accuracy) {
    Walks<B, A, float> walks(s, accuracy);
    walks.template forward<0>();
    const PlainImages<float> expected = plain(s, accuracy);
    return std::max({(walks.r.feature.pixels - expected.feature).cwiseAbs().maxCoeff(),
                     (walks.r.alpha.pixels - expected.alpha).cwiseAbs().maxCoeff(),
                     (walks.r.depth.pixels - expected.depth).cwiseAbs().maxCoeff() / 4});
}

TEST_CASE_TEMPLATE_DEFINE("widths: every preset keeps its promise", B, width_presets) {
    for (const auto& s : {sized_scene<float>(33, 17, 5, 1), random_scene<float>(90, 9, 2)}) {
        const OracleImages expected = truth(s);
        CHECK(preset_gap<B>(s, expected, Exact64()) < 5e-5);
        CHECK(preset_gap<B>(s, expected, Exact32()) < 5e-5);
        CHECK(preset_gap<B>(s, expected, Balanced(Tight())) < 1e-3);
        CHECK(preset_gap<B>(s, expected, Balanced()) < 1.0 / 255);
        CHECK(preset_gap<B>(s, expected, Fast()) < 12.0 / 255);
        // A contribution at the threshold may be in one and not in the other.
        CHECK(plain_gap<B>(s, Compatible3dgs()) < 1.0 / 255);
        CHECK(plain_gap<B>(s, Compatible3dgsFloor()) < 1.0 / 255);
    }
}

TEST_CASE_TEMPLATE_DEFINE("widths: every choice of outputs", B, width_outputs) {
    using Lean = Drawing<Balanced, features_only>;
    using Picking = Drawing<Balanced, Outputs{.depth = false, .contributor = true}>;
    using All = Drawing<Balanced, Outputs{.depth = true, .contributor = true}>;
    const auto s = sized_scene<float>(33, 31, 3, 3);
    Walks<B, Balanced, float> usual(s, Balanced());
    Walks<B, Lean, float> lean(s, Lean());
    Walks<B, Picking, float> picking(s, Picking());
    Walks<B, All, float> all(s, All());
    usual.template forward<3>();
    lean.template forward<3>();
    picking.template forward<3>();
    all.template forward<3>();
    for (const auto* pixels : {&lean.r.feature.pixels, &picking.r.feature.pixels,
                               &all.r.feature.pixels})
        CHECK(*pixels == usual.r.feature.pixels);
    CHECK(all.r.depth.pixels == usual.r.depth.pixels);
    CHECK(all.r.contributor.pixels == picking.r.contributor.pixels);

    const auto d = sized_scene<double>(33, 31, 5, 3);
    Walks<B, All, double> exact(d, All(Exact64()));
    exact.template forward<0>();
    const PlainImages<double> expected = plain(d, Exact64());
    CHECK(exact.r.contributor.pixels == expected.contributor);
    CHECK((exact.r.depth.pixels - expected.depth).cwiseAbs().maxCoeff() < 1e-11);
}

template <class B, int C>
void check_gradient(const Scenery<float>& s, const Weights<float>& w, double bound) {
    const Balanced accuracy = Exact32();
    Walks<B, Balanced, float> walks(s, accuracy);
    walks.template forward<C>();
    CHECK(gap(walks.template reverse<C, true>(w), plain_gradient(s, accuracy, w, true)) < bound);
    CHECK(gap(walks.template reverse<C, false>(w), plain_gradient(s, accuracy, w, false)) < bound);
}

TEST_CASE_TEMPLATE_DEFINE("widths: gradients of every size and number of channels", B,
                          width_gradients) {
    const auto check = [](const Scenery<float>& s, double bound) {
        CAPTURE(s.name);
        CAPTURE(s.camera.width);
        CAPTURE(s.camera.height);
        CAPTURE(s.gaussians.channels());
        const Weights<float> w(s, 31);
        check_gradient<B, 0>(s, w, bound);
        switch (s.gaussians.channels()) {
        case 1: check_gradient<B, 1>(s, w, bound); break;
        case 3: check_gradient<B, 3>(s, w, bound); break;
        case 4: check_gradient<B, 4>(s, w, bound); break;
        default: break;
        }
    };
    each_awkward_scene<float>([&](const Scenery<float>& s) { check(s, 1e-4); });
    for (const auto& s : hard_scenes<float>(9))
        check(s, s.name == "needles of 300 px" || s.name == "huge" ? 1e-2 : 1e-4);
}

/// The gap of the dot-product test, relative to the sum of the magnitudes of the terms.
template <class B, int C, class A>
double dual_gap(const Scenery<double>& s, const A& accuracy) {
    const Weights<double> w(s, 41);
    Gaussians<double> v = noise_like(s.gaussians, 44);
    v.scale = v.scale.cwiseProduct(s.gaussians.scale);
    Walks<B, A, double> walks(s, accuracy);
    walks.template forward<C>();
    const Gaussians<double> g = walks.template reverse<C, true>(w);
    double reverse = 0, scale = 0;
    Gaussians<double>::fields(
        [&](const std::string&, const Columns<double>& a, const Columns<double>& d) {
            reverse += a.cwiseProduct(d).sum();
            scale += a.cwiseProduct(d).cwiseAbs().sum();
        },
        g, v);
    return std::abs(slope(s, accuracy, v, w) - reverse) / (scale + 1e-30);
}

TEST_CASE_TEMPLATE_DEFINE("widths: gradients are those of duals", B, width_duals) {
    for (const int channels : awkward) {
        const auto s = sized_scene<double>(channels, 17, channels, std::uint64_t(channels));
        CAPTURE(channels);
        CHECK(dual_gap<B, 0>(s, Balanced()) < 1e-12);
        CHECK(dual_gap<B, 0>(s, Balanced(Exact64())) < 1e-12);
        if (channels == 3) CHECK(dual_gap<B, 3>(s, Balanced(Fast())) < 1e-12);
    }
    const auto s = sized_scene<double>(31, 17, 9, 7);
    CHECK(dual_gap<B, 0>(s, Compatible3dgs()) < 1e-12);
    CHECK(dual_gap<B, 0>(s, Compatible3dgsFloor()) < 1e-12);
}

/// The laws of splatting for each backend of a list.
#define RYE_SPLAT_LAWS(...)                                                                        \
    TEST_CASE_TEMPLATE_APPLY(width_images, __VA_ARGS__);                                           \
    TEST_CASE_TEMPLATE_APPLY(width_hard_scenes, __VA_ARGS__);                                      \
    TEST_CASE_TEMPLATE_APPLY(width_presets, __VA_ARGS__);                                          \
    TEST_CASE_TEMPLATE_APPLY(width_outputs, __VA_ARGS__);                                          \
    TEST_CASE_TEMPLATE_APPLY(width_gradients, __VA_ARGS__);                                        \
    TEST_CASE_TEMPLATE_APPLY(width_duals, __VA_ARGS__)

} // namespace rye::test
