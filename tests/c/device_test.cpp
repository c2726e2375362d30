// SPDX-License-Identifier: Apache-2.0
/// tests/c/device_test.cpp: what rye/c/device.h draws is what the headers draw; what does not fit
/// is NaN and said so; every wrong argument is a code with a message. The device is emulated.
#include <rye/c/device.h>

#include <cmath>
#include <cstdlib>
#include <string>

#include <doctest/doctest.h>

#include <rye/gaussian/activate.hpp>
#include <rye/splat/lanes.hpp>

#include "../support/random.hpp"

using namespace rye;

namespace {

struct Shown {
    int width = 48, height = 40;
    GaussianCloud<float> cloud;
    Gaussians<float> g;
    VecX<float> background;

    Shown(Index count, Index channels, float size = 0.1F)
        : cloud(count, 2),
          g(count, channels),
          background(0.25F * VecX<float>::Ones(channels)) {
        g.mean = 0.5F * random_columns<float>(3, count, 1);
        g.rotation = random_columns<float>(4, count, 2);
        g.scale = (0.05F * random_columns<float>(3, count, 3)).array() + size;
        g.opacity = (0.4F * random_columns<float>(1, count, 4)).array() + 0.5F;
        g.feature = random_columns<float>(channels, count, 5);
    }
    Pinhole<float> camera() const {
        return look_at<float>({0, 0, 4}, {0, 0, 0}, {0, 1, 0}, 0.5F, {width, height});
    }
    rye_camera c_camera() const {
        rye_look look = RYE_INIT(rye_look);
        look.eye[2] = 4;
        look.up[1] = 1;
        look.vertical_fov = 0.5F;
        look.width = width;
        look.height = height;
        rye_camera c = RYE_INIT(rye_camera);
        REQUIRE(rye_camera_look_at(&look, &c) == RYE_OK);
        return c;
    }
    rye_device_cloud c_cloud() const {
        rye_device_cloud c = RYE_INIT(rye_device_cloud);
        c.channels = static_cast<std::int32_t>(g.channels());
        c.count = g.count();
        c.mean = g.mean.data();
        c.rotation = g.rotation.data();
        c.scale = g.scale.data();
        c.opacity = g.opacity.data();
        c.feature = g.feature.data();
        return c;
    }
    Index pixels() const { return Index(width) * height; }
};

/// A picture and what is needed for it.
struct Picture {
    Columns<float> feature, alpha;
    rye_device_image image = RYE_INIT(rye_device_image);

    explicit Picture(const Shown& s) : feature(s.g.channels(), s.pixels()), alpha(1, s.pixels()) {
        image.feature = feature.data();
        image.alpha = alpha.data();
    }
};

/// A renderer with one frame.
struct Renderer {
    rye_device_renderer* renderer = nullptr;
    rye_device_frame* frame = nullptr;

    explicit Renderer(const rye_device_options* options = nullptr) {
        REQUIRE(rye_device_renderer_create(options, &renderer) == RYE_OK);
        REQUIRE(rye_device_frame_create(renderer, &frame) == RYE_OK);
    }
    Renderer(const Renderer&) = delete;
    Renderer& operator=(const Renderer&) = delete;
    ~Renderer() {
        rye_device_frame_destroy(frame);
        rye_device_renderer_destroy(renderer);
    }
    rye_status draw(const Shown& s, Picture& p, int gradient = 1) {
        const rye_device_cloud cloud = s.c_cloud();
        const rye_camera camera = s.c_camera();
        return rye_device_draw(frame, &cloud, &camera, s.background.data(), &p.image, gradient,
                               nullptr);
    }
    rye_device_cost finish(int wait = 1) {
        rye_device_cost cost = RYE_INIT(rye_device_cost);
        REQUIRE(rye_device_finish(frame, wait, &cost) == RYE_OK);
        return cost;
    }
};

void close(const char* name, const Columns<float>& a, const Columns<float>& b, float bound) {
    INFO(name);
    const float size = b.cwiseAbs().maxCoeff();
    CHECK(size > 0);
    CHECK((a - b).cwiseAbs().maxCoeff() <= bound * size);
}

rye_device_cloud_gradient gradient_in(Gaussians<float>& out) {
    rye_device_cloud_gradient g = RYE_INIT(rye_device_cloud_gradient);
    g.mean = out.mean.data();
    g.rotation = out.rotation.data();
    g.scale = out.scale.data();
    g.opacity = out.opacity.data();
    g.feature = out.feature.data();
    return g;
}

/// Whether the last failure has this code and a message with these words.
void failed(rye_status got, rye_status status, const std::string& words) {
    CHECK(got == status);
    INFO(std::string(rye_device_message()));
    CHECK(std::string(rye_device_message()).find(words) != std::string::npos);
}

template <class A>
void draws_as_headers(const A& accuracy, const rye_device_options& options, Index channels) {
    const Shown s(200, channels);
    Rasterizer<A> rasterizer;
    rasterizer.accuracy = accuracy;
    const XsimdBackend backend;
    const auto raster = rasterizer.forward(backend, s.g, s.camera(), s.background);
    const Columns<float> g_feature = random_columns<float>(channels, s.pixels(), 7),
                         g_alpha = random_columns<float>(1, s.pixels(), 8);
    const auto want = rasterizer.vjp(backend, s.g, s.camera(), s.background, raster, g_feature,
                                     &g_alpha, nullptr);
    Renderer r(&options);
    Picture p(s);
    REQUIRE(r.draw(s, p) == RYE_OK);
    CHECK(r.finish().fits == 1);
    CHECK(r.finish().skipped == 0);
    CHECK(r.finish().entries > 0);
    close("feature", p.feature, raster.feature.pixels, 2e-5F);
    close("alpha", p.alpha, raster.alpha.pixels, 2e-5F);

    const rye_device_cloud cloud = s.c_cloud();
    rye_device_image_gradient image = RYE_INIT(rye_device_image_gradient);
    image.feature = g_feature.data();
    image.alpha = g_alpha.data();
    Gaussians<float> out(s.g.count(), channels);
    Columns<float> background(channels, 1);
    rye_device_cloud_gradient g = gradient_in(out);
    g.background = background.data();
    REQUIRE(rye_device_gradient(r.frame, &cloud, &image, &g) == RYE_OK);
    Gaussians<float>::fields([](const std::string& name, const auto& a,
                                const auto& b) { close(name.c_str(), a, b, 2e-4F); },
                             out, want);
    const Columns<float> free =
        (1 - raster.alpha.pixels.array()).matrix();
    close("background", background, g_feature * free.transpose(), 1e-4F);

    // Not all of them, and once more: the same bits.
    Gaussians<float> again(s.g.count(), channels);
    rye_device_cloud_gradient some = RYE_INIT(rye_device_cloud_gradient);
    some.mean = again.mean.data();
    REQUIRE(rye_device_gradient(r.frame, &cloud, &image, &some) == RYE_OK);
    CHECK(again.mean == out.mean);
}

rye_device_options options_of(int accuracy, int antialias = RYE_ANTIALIAS_DILATE) {
    rye_device_options o = RYE_INIT(rye_device_options);
    o.accuracy = accuracy;
    o.antialias = antialias;
    return o;
}

struct Mip : Balanced {
    static constexpr Antialias antialias = Antialias::mip;
};

} // namespace

TEST_CASE("C interface of a device: image and gradient are those of the headers") {
    for (const Index channels : {1, 3, 5})
        draws_as_headers(Balanced(), options_of(RYE_ACCURACY_BALANCED), channels);
    draws_as_headers(Tight(), options_of(RYE_ACCURACY_TIGHT), 3);
    draws_as_headers(Compatible3dgs(), options_of(RYE_ACCURACY_3DGS), 3);
    draws_as_headers(Mip(), options_of(RYE_ACCURACY_BALANCED, RYE_ANTIALIAS_MIP), 3);
    rye_device_options wide = options_of(RYE_ACCURACY_BALANCED);
    wide.dilation = 1.5F;
    Balanced dilated;
    dilated.dilation = 1.5;
    draws_as_headers(dilated, wide, 3);
}

TEST_CASE("C interface of a device: harmonics as PyTorch keeps them") {
    Shown s(150, 3);
    constexpr Index bases = 16; // of which degree 2 reads 9
    const Columns<float> triples = random_columns<float>(3 * bases, 150, 11);
    for (Index i = 0; i < 150; ++i)
        for (Index c = 0; c < 3; ++c) {
            s.cloud.sh_constant(c, i) = triples(c, i);
            for (Index k = 0; k < 8; ++k) s.cloud.sh_rest(8 * c + k, i) = triples(3 * (k + 1) + c, i);
        }
    s.cloud.mean = s.g.mean;
    const Vec3<float> eye(0, 0, 4);
    s.g.feature = sh_colors(s.cloud, eye);
    Renderer r;
    Picture want(s), got(s);
    REQUIRE(r.draw(s, want) == RYE_OK);
    const Columns<float> g_feature = random_columns<float>(3, s.pixels(), 7);
    rye_device_image_gradient image = RYE_INIT(rye_device_image_gradient);
    image.feature = g_feature.data();
    Gaussians<float> of_color(150, 3), of_harmonics(150, 3);
    rye_device_cloud_gradient g = gradient_in(of_color);
    rye_device_cloud cloud = s.c_cloud();
    REQUIRE(rye_device_gradient(r.frame, &cloud, &image, &g) == RYE_OK);

    cloud.feature = nullptr;
    cloud.harmonics = triples.data();
    cloud.bases = bases;
    cloud.degree = 2;
    const rye_camera camera = s.c_camera();
    REQUIRE(rye_device_draw(r.frame, &cloud, &camera, s.background.data(), &got.image, 1,
                            nullptr) == RYE_OK);
    close("feature", got.feature, want.feature, 1e-6F);
    Columns<float> g_triples(3 * bases, 150);
    g = gradient_in(of_harmonics);
    g.feature = nullptr;
    g.harmonics = g_triples.data();
    REQUIRE(rye_device_gradient(r.frame, &cloud, &image, &g) == RYE_OK);
    GaussianCloud<float> back(150, 2);
    back.mean = of_color.mean;
    sh_colors_vjp(s.cloud, eye, of_color.feature, back);
    close("mean", of_harmonics.mean, back.mean, 1e-5F);
    close("constant", g_triples.topRows(3), back.sh_constant, 1e-5F);
    for (Index c = 0; c < 3; ++c)
        for (Index k = 0; k < 8; ++k)
            close("rest", g_triples.row(3 * (k + 1) + c), back.sh_rest.row(8 * c + k), 1e-5F);
    CHECK(g_triples.bottomRows(3 * (bases - 9)).isZero(0));
}

TEST_CASE("C interface of a device: a frame that does not fit is NaN, and fits when drawn again") {
    Shown s(300, 3, 2.0F); // each covers every tile
    s.width = s.height = 320;
    Renderer r;
    Picture p(s);
    const rye_device_cloud cloud = s.c_cloud();
    const Columns<float> g_feature = Columns<float>::Ones(3, s.pixels());
    rye_device_image_gradient image = RYE_INIT(rye_device_image_gradient);
    image.feature = g_feature.data();
    Gaussians<float> out(300, 3);
    const rye_device_cloud_gradient g = gradient_in(out);
    REQUIRE(r.draw(s, p) == RYE_OK);
    REQUIRE(rye_device_gradient(r.frame, &cloud, &image, &g) == RYE_OK);
    const rye_device_cost cost = r.finish(0);
    CHECK(cost.fits == 0);
    CHECK(p.feature.array().isNaN().all());
    CHECK(p.alpha.array().isNaN().all());
    CHECK(out.mean.array().isNaN().all());
    REQUIRE(r.draw(s, p) == RYE_OK);
    CHECK(r.finish().fits == 1);
    CHECK(p.feature.allFinite());
    REQUIRE(rye_device_gradient(r.frame, &cloud, &image, &g) == RYE_OK);
    CHECK(out.mean.allFinite());

    Renderer told;
    REQUIRE(rye_device_frame_room(told.frame, 2 * cost.entries, 2 * cost.entries) == RYE_OK);
    REQUIRE(told.draw(s, p) == RYE_OK);
    CHECK(told.finish().fits == 1);
}

TEST_CASE("C interface of a device: memory is the caller's") {
    struct Memory {
        int held = 0, calls = 0;
        bool full = false;
    } memory;
    rye_device_options o = RYE_INIT(rye_device_options);
    o.context = &memory;
    o.allocate = [](void* m, std::size_t bytes, void*) -> void* {
        auto& of = *static_cast<Memory*>(m);
        if (of.full) return nullptr;
        ++of.held;
        ++of.calls;
        return std::aligned_alloc(256, (bytes + 255) / 256 * 256);
    };
    o.release = [](void* m, void* p, void*) {
        --static_cast<Memory*>(m)->held;
        std::free(p);
    };
    const Shown s(100, 3);
    Picture p(s);
    {
        Renderer r(&o);
        REQUIRE(r.draw(s, p) == RYE_OK);
        CHECK(memory.held > 0);
        const int calls = memory.calls;
        REQUIRE(r.draw(s, p) == RYE_OK);
        CHECK(memory.calls == calls); // what is there is used again
    }
    CHECK(memory.held == 0);
    memory.full = true;
    Renderer r(&o);
    failed(r.draw(s, p), RYE_ERROR_ARGUMENT, "no room for");
}

TEST_CASE("C interface of a device: wrong arguments are named") {
    const Shown s(50, 3);
    Renderer r;
    Picture p(s);
    rye_device_cloud cloud = s.c_cloud();
    rye_camera camera = s.c_camera();
    const auto draw = [&] {
        return rye_device_draw(r.frame, &cloud, &camera, nullptr, &p.image, 1, nullptr);
    };
    rye_device_cost cost = RYE_INIT(rye_device_cost);
    failed(rye_device_finish(r.frame, 1, &cost), RYE_ERROR_STATE, "has drawn nothing");
    Gaussians<float> out(50, 3);
    const rye_device_cloud_gradient g = gradient_in(out);
    rye_device_image_gradient image = RYE_INIT(rye_device_image_gradient);
    image.feature = p.feature.data();
    failed(rye_device_gradient(r.frame, &cloud, &image, &g), RYE_ERROR_STATE, "no picture");
    REQUIRE(draw() == RYE_OK);
    CHECK(p.feature.allFinite()); // over zeros
    cloud.count = 49;
    failed(rye_device_gradient(r.frame, &cloud, &image, &g), RYE_ERROR_STATE, "no picture");
    cloud = s.c_cloud();
    REQUIRE(r.draw(s, p, 0) == RYE_OK);
    failed(rye_device_gradient(r.frame, &cloud, &image, &g), RYE_ERROR_STATE, "no picture");

    cloud.struct_size = 8;
    failed(draw(), RYE_ERROR_VERSION, "struct_size 8");
    cloud = s.c_cloud();
    cloud.mean = nullptr;
    failed(draw(), RYE_ERROR_ARGUMENT, "cloud: mean");
    cloud = s.c_cloud();
    cloud.channels = 2000;
    failed(draw(), RYE_ERROR_ARGUMENT, "got 2000, expected 1 to 1024");
    cloud = s.c_cloud();
    cloud.harmonics = s.g.mean.data();
    failed(draw(), RYE_ERROR_ARGUMENT, "harmonics alone");
    cloud.feature = nullptr;
    cloud.degree = 2;
    cloud.bases = 8;
    failed(draw(), RYE_ERROR_ARGUMENT, "got 8, expected 9");
    cloud = s.c_cloud();
    camera.fx = NAN;
    failed(draw(), RYE_ERROR_ARGUMENT, "fx");
    rye_device_options o = options_of(7);
    rye_device_renderer* none = nullptr;
    failed(rye_device_renderer_create(&o, &none), RYE_ERROR_ARGUMENT, "accuracy");
    o = options_of(0, 3);
    failed(rye_device_renderer_create(&o, &none), RYE_ERROR_ARGUMENT, "antialias");
    o = options_of(0);
    o.release = [](void*, void*, void*) {};
    failed(rye_device_renderer_create(&o, &none), RYE_ERROR_ARGUMENT, "allocate and release");
    failed(rye_device_frame_create(nullptr, nullptr), RYE_ERROR_ARGUMENT, "null");
    CHECK(none == nullptr);
}
