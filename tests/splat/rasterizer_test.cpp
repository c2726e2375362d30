// SPDX-License-Identifier: Apache-2.0
// Laws of a render under any policy: backends agree, threads and permutations change no bit, crops
// equal crops of the image, non-finite Gaussians are culled and counted, and empty scenes render.
#include <rye/splat/lanes.hpp>

#include <doctest/doctest.h>

#include <limits>

#include "../support/scenes.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using Plain = ScalarBackend<Serial>;
using Lanes = XsimdBackend<DefaultArch, Serial>;
using LanesThreaded = XsimdBackend<>;

template <class T>
double relative(const Columns<T>& a, const Columns<T>& b) {
    return double((a - b).norm()) / (double(b.norm()) + 1e-20);
}

template <class B, class A = Balanced, class T>
Gaussians<T> gradients(const Scenery<T>& s, const Raster<T>& r, const A& accuracy = {}) {
    const Columns<T> wf = noise<T>(s.gaussians.channels(), r.feature.size(), 21);
    const Columns<T> wa = noise<T>(1, r.feature.size(), 22), wd = noise<T>(1, r.feature.size(), 23);
    return Rasterizer<A>{accuracy}.vjp(B{}, s.gaussians, s.camera, s.background, r, wf, &wa, &wd);
}

template <class B, class A = Balanced, class T>
Raster<T> render(const Scenery<T>& s, const A& accuracy = {}) {
    return Rasterizer<A>{accuracy}.forward(B{}, s.gaussians, s.camera, s.background);
}

template <class T>
bool same(const Raster<T>& a, const Raster<T>& b) {
    return a.feature.pixels == b.feature.pixels && a.alpha.pixels == b.alpha.pixels &&
           a.depth.pixels == b.depth.pixels;
}

template <class T>
bool same(const Gaussians<T>& a, const Gaussians<T>& b) {
    bool equal = true;
    Gaussians<T>::fields([&](const std::string&, const auto& x, const auto& y) { equal &= x == y; },
                         a, b);
    return equal;
}

} // namespace

TEST_CASE("rasterizer: lanes agree with the plain loops for every number of channels") {
    for (const Index channels : {1, 2, 3, 4, 8, 12, 16, 32}) {
        CAPTURE(channels);
        auto scenes = hard_scenes<float>(channels);
        scenes.push_back(random_scene<float>(120, channels, 5));
        for (const auto& s : scenes) {
            CAPTURE(s.name);
            const bool needle = s.name == "needles of 300 px" || s.name == "huge";
            const Balanced exact = Exact32();
            const Raster<float> a = render<Plain>(s, exact), b = render<Lanes>(s, exact);
            const auto far = (a.feature.pixels - b.feature.pixels).cwiseAbs().maxCoeff();
            CHECK(far < (needle ? 2e-3F : 2e-5F));
            const auto deep = (a.depth.pixels - b.depth.pixels).cwiseAbs().maxCoeff();
            CHECK(deep < (needle ? 5e-3F : 1e-4F));
            const Gaussians<float> ga = gradients<Plain>(s, a, exact);
            const Gaussians<float> gb = gradients<Lanes>(s, b, exact);
            Gaussians<float>::fields(
                [&](const std::string& name, const Columns<float>& x, const Columns<float>& y) {
                    CAPTURE(name);
                    CHECK(relative(y, x) < (needle ? 1e-2 : 1e-4));
                },
                ga, gb);
        }
    }
}

TEST_CASE("rasterizer: the other rules agree between backends too") {
    auto s = random_scene<float>(150, 3, 6, 0.15);
    s.gaussians.opacity.array() = 0.5F + 0.5F * s.gaussians.opacity.array();
    const auto check = [&](const auto& accuracy) {
        using A = std::remove_cvref_t<decltype(accuracy)>;
        const Raster<float> a = render<Plain, A>(s), b = render<Lanes, A>(s);
        // A contribution at the threshold may be in one and not in the other.
        CHECK((a.feature.pixels - b.feature.pixels).cwiseAbs().maxCoeff() < accuracy.alpha_min);
        CHECK(relative(gradients<Lanes, A>(s, b).mean, gradients<Plain, A>(s, a).mean) < 1e-2);
    };
    check(Balanced());
    check(Compatible3dgsFloor());
}

TEST_CASE("rasterizer: the number of threads changes no bit") {
    const auto s = random_scene<float>(3000, 32, 7);
    const auto one = render<Lanes>(s), two = render<LanesThreaded>(s);
    CHECK(same(one, two));
    CHECK(same(gradients<Lanes>(s, one), gradients<LanesThreaded>(s, two)));
    const auto p = random_scene<double>(2100, 2, 8);
    const auto first = render<ScalarBackend<Serial>>(p), second = render<ScalarBackend<>>(p);
    CHECK(same(first, second));
    CHECK(same(gradients<ScalarBackend<Serial>>(p, first), gradients<ScalarBackend<>>(p, second)));
}

TEST_CASE("rasterizer: shared memory changes no bit, whatever was there before") {
    const auto s = random_scene<float>(200, 8, 9), other = random_scene<float>(500, 8, 10);
    const Rasterizer<> rasterizer;
    RasterScratch<float> scratch;
    Raster<float> r;
    Gaussians<float> g;
    for (const auto* scene : {&other, &s}) {
        rasterizer.forward_into(Lanes{}, scene->gaussians, scene->camera, scene->background, r,
                                &scratch);
        const Columns<float> w = noise<float>(8, r.feature.size(), 21);
        rasterizer.vjp_into(Lanes{}, scene->gaussians, scene->camera, scene->background, r, {w}, g,
                            &scratch);
    }
    const auto fresh = render<Lanes>(s);
    CHECK(same(r, fresh));
    CHECK(same(g, rasterizer.vjp(Lanes{}, s.gaussians, s.camera, s.background, fresh,
                                 noise<float>(8, fresh.feature.size(), 21))));
}

TEST_CASE("rasterizer: another order of the Gaussians is the same image, bit for bit") {
    const auto s = random_scene<float>(400, 8, 11);
    auto p = s;
    const Index n = s.gaussians.count();
    Gaussians<float>::fields(
        [&](const std::string&, Columns<float>& a, const Columns<float>& from) {
            for (Index i = 0; i < n; ++i) a.col((i * 7 + 3) % n) = from.col(i);
        },
        p.gaussians, s.gaussians);
    CHECK(same(render<Lanes>(s), render<Lanes>(p)));
    CHECK(same(render<Plain>(s), render<Plain>(p)));
}

TEST_CASE("rasterizer: a crop of the image is the image of a crop, bit for bit") {
    auto s = random_scene<float>(150, 3, 12);
    const int x0 = 5, y0 = 9;
    auto crop = s;
    crop.camera.cx -= float(x0);
    crop.camera.cy -= float(y0);
    crop.camera.width = 21;
    crop.camera.height = 13;
    const Balanced accuracy{.frustum_margin = 100};  // the limits follow the image, so open them
    const auto whole = render<Lanes>(s, accuracy), part = render<Lanes>(crop, accuracy);
    bool equal = true;
    for (int y = 0; y < crop.camera.height; ++y)
        for (int x = 0; x < crop.camera.width; ++x)
            equal &= part.feature.at(x, y) == whole.feature.at(x + x0, y + y0);
    CHECK(equal);

    // Gradients: those of the whole image whose cotangent is zero outside the crop.
    const Columns<float> w = noise<float>(3, part.feature.size(), 3);
    Columns<float> wide = Columns<float>::Zero(3, whole.feature.size());
    for (int y = 0; y < crop.camera.height; ++y)
        for (int x = 0; x < crop.camera.width; ++x)
            wide.col(Index(y + y0) * s.camera.width + x + x0) =
                w.col(Index(y) * crop.camera.width + x);
    const Rasterizer<> r{accuracy};
    const auto a = r.vjp(Lanes{}, crop.gaussians, crop.camera, crop.background, part, w);
    const auto b = r.vjp(Lanes{}, s.gaussians, s.camera, s.background, whole, wide);
    CHECK(relative(a.mean, b.mean) < 1e-6);
    CHECK(relative(a.rotation, b.rotation) < 1e-6);
}

TEST_CASE_TEMPLATE("rasterizer: a bad number leaves its Gaussian out, and is counted", B, Plain,
                   Lanes) {
    const auto clean = random_scene<float>(41, 3, 13);
    const float bad[] = {std::numeric_limits<float>::quiet_NaN(),
                         std::numeric_limits<float>::infinity(),
                         -std::numeric_limits<float>::infinity()};
    auto without = clean;
    without.gaussians.opacity(0, 17) = 0;
    const auto expected = render<B>(without);
    Gaussians<float>::fields(
        [&](const std::string& name, const Columns<float>& a) {
            for (Index row = 0; row < a.rows(); ++row)
                for (const float x : bad) {
                    auto s = clean;
                    Gaussians<float>::fields(
                        [&](const std::string& n, Columns<float>& c) {
                            if (n == name) c(row, 17) = x;
                        },
                        s.gaussians);
                    const auto r = render<B>(s);
                    CHECK(same(r, expected));
                    CHECK(r.trace.non_finite == 1);
                    const auto g = gradients<B>(s, r);
                    CHECK(g.mean.allFinite());
                    CHECK(g.mean.col(17).isZero(0));
                    CHECK_THROWS_AS((render<B>(s, Balanced{.non_finite = NonFinite::fail})), Error);
                }
        },
        clean.gaussians);
}

TEST_CASE_TEMPLATE("rasterizer: a rotation of zeros is the identity, with gradient 0 (C1)", B, Plain,
                   Lanes) {
    auto s = random_scene<float>(40, 3, 13);
    s.gaussians.rotation.col(17) = Quat<float>(1, 0, 0, 0);
    const auto expected = render<B>(s);
    s.gaussians.rotation.col(17).setZero();
    const auto r = render<B>(s, Balanced{.non_finite = NonFinite::fail});
    CHECK(r.trace.non_finite == 0);
    CHECK(same(r, expected));
    const auto g = gradients<B>(s, r);
    CHECK(g.rotation.col(17).isZero(0));
    CHECK(g.mean.allFinite());
    CHECK_FALSE(g.scale.col(17).isZero(0));
}

TEST_CASE_TEMPLATE("rasterizer: opacity up to the threshold draws nothing", B, Plain, Lanes) {
    auto s = random_scene<float>(1, 1, 14);
    const float threshold = 1.0F / 2550;
    for (const float o : {0.0F, threshold * 0.999F, -1.0F}) {
        s.gaussians.opacity.setConstant(o);
        CHECK(render<B>(s).alpha.pixels.isZero(0));
    }
    s.gaussians.mean.setZero();
    s.gaussians.opacity.setConstant(threshold * 3);
    CHECK(render<B>(s).alpha.pixels.maxCoeff() > threshold);
}

TEST_CASE_TEMPLATE("rasterizer: no Gaussian, no pixel", B, Plain, Lanes) {
    auto s = random_scene<float>(0, 32, 15);
    const auto r = render<B>(s);
    CHECK(r.alpha.pixels.isZero(0));
    CHECK(r.feature.pixels.colwise().sum().isConstant(s.background.sum(), 1e-4F));
    CHECK(gradients<B>(s, r).count() == 0);
    auto none = random_scene<float>(20, 3, 16);
    none.camera.width = none.camera.height = 0;
    CHECK(render<B>(none).feature.size() == 0);
    none.camera.width = 4096;
    none.camera.height = 1;
    CHECK(render<B>(none).feature.size() == 4096);
}

TEST_CASE("rasterizer: arguments of another shape are refused") {
    auto s = random_scene<float>(5, 3, 17);
    const auto r = render<Plain>(s);
    const Columns<float> narrow = noise<float>(2, r.feature.size(), 1);
    CHECK_THROWS_AS(Rasterizer<>().vjp(Plain{}, s.gaussians, s.camera, s.background, r, narrow),
                    Error);
    s.background.resize(2);
    CHECK_THROWS_AS(render<Plain>(s), Error);
    s = random_scene<float>(5, 3, 17);
    s.gaussians.scale.resize(3, 4);
    CHECK_THROWS_AS(render<Plain>(s), Error);
    s = random_scene<float>(50, 3, 17, 10);
    CHECK_THROWS_AS(render<Plain>(s, Balanced{.max_memory = 100 * TileLists::entry_bytes<>}), Error);
}

TEST_CASE("rasterizer: an alpha_min that is not positive is refused") {
    const auto s = random_scene<float>(5, 3, 17);
    const auto r = render<Plain>(s);
    for (const double least : {0.0, -1.0, 1e-60, std::numeric_limits<double>::quiet_NaN()}) {
        CAPTURE(least);
        CHECK_THROWS_AS(render<Plain>(s, Balanced{.alpha_min = least}), Error);
        CHECK_THROWS_AS(render<Lanes>(s, Balanced{.alpha_min = least}), Error);
        CHECK_THROWS_AS(gradients<Plain>(s, r, Balanced{.alpha_min = least}), Error);
    }
}

TEST_CASE_TEMPLATE("rasterizer: a splat at a pixel's centre survives flips bit for bit", B, Plain,
                   Lanes) {
    auto s = random_scene<float>(1, 1, 18);
    s.camera.width = s.camera.height = 17;
    s.camera.cx = s.camera.cy = 8.5F;
    s.camera.fx = s.camera.fy = 32;
    s.camera.camera_from_world.translation = Vec3<float>(0, 0, 2);
    s.gaussians.mean.setZero();
    s.gaussians.scale.setConstant(0.125F);
    s.gaussians.rotation.col(0) << 1, 0, 0, 0;
    s.gaussians.opacity.setConstant(0.5F);
    const auto r = render<B>(s);
    const Columns<float> a = Eigen::Map<const Columns<float>>(r.alpha.pixels.data(), 17, 17);
    const Columns<float> sideways = a.rowwise().reverse(), upside = a.colwise().reverse();
    const bool flips = a == sideways && a == upside;
    CHECK(flips);
    // u^2 and v^2 are subtracted one after the other, so a transpose may round differently.
    CHECK((a - a.transpose()).cwiseAbs().maxCoeff() < 1e-6F);
    CHECK(a(8, 8) == doctest::Approx(0.5F).epsilon(1e-6));
}

TEST_CASE_TEMPLATE("rasterizer: the inclusive stop loses at most stop, the exclusive one more", B,
                   Plain, Lanes) {
    // Behind layers that leave T = 0.0099, an all but opaque white one, on black.
    auto s = random_scene<float>(2, 1, 19);
    s.background.setZero();
    s.gaussians.mean.setZero();
    s.gaussians.mean(2, 1) = 1;
    s.gaussians.scale.setConstant(50.0F);
    s.gaussians.feature << 0, 1;
    s.gaussians.opacity << 1 - 0.0099F, 0.995F;
    s.camera.cx = s.camera.cy = 4.5F;
    s.camera.width = s.camera.height = 9;
    s.camera.camera_from_world.translation = Vec3<float>(0, 0, 3);
    Compatible3dgsFloor late;
    late.alpha_floor = 0;
    late.alpha_max = 0.999;
    Balanced inclusive;
    inclusive.stop = 1e-4;
    const float truth = 0.0099F * 0.995F;
    CHECK(std::abs(render<B>(s, inclusive).feature.at(4, 4)[0] - truth) <= 1.1e-4F);
    CHECK(std::abs(render<B, Compatible3dgsFloor>(s, late).feature.at(4, 4)[0] - truth) > 5e-3F);
}
