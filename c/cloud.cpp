// SPDX-License-Identifier: Apache-2.0
/// c/cloud.cpp: cameras, images and gradients of a cloud, as rye/c/rye.h has them.
#include <algorithm>
#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <variant>

#include <rye/splat/lanes.hpp>

#include "objects.hpp"

namespace rye::c {
namespace {

/// As Rasterizer, of a preset with depths.
template <class A>
struct Drawing {
    Rasterizer<A> rasterizer;
    Raster<float, A::outputs> raster;
};
template <class A>
struct WithDepth : A {
    static constexpr Outputs outputs = {.depth = true};
};
using AnyDrawing = std::variant<Drawing<WithDepth<Balanced>>, Drawing<WithDepth<Fast>>,
                                Drawing<WithDepth<Tight>>, Drawing<WithDepth<Compatible3dgs>>>;

AnyDrawing drawing_of(int accuracy) {
    switch (accuracy) {
        case RYE_ACCURACY_FAST:
            return Drawing<WithDepth<Fast>>();
        case RYE_ACCURACY_TIGHT:
            return Drawing<WithDepth<Tight>>();
        case RYE_ACCURACY_3DGS:
            return Drawing<WithDepth<Compatible3dgs>>();
        default:
            return Drawing<WithDepth<Balanced>>();
    }
}

GaussianView<float> view_of(const rye_cloud* cloud) {
    check_struct(cloud, "cloud");
    require(cloud->channels >= 1 && cloud->channels <= 1024, "cloud: channels", "got ",
            cloud->channels, ", expected 1 to 1024");
    constexpr std::int64_t most = std::numeric_limits<std::int32_t>::max();
    require(cloud->count >= 0 && cloud->count <= most, "cloud: count", "got ", cloud->count,
            ", expected 0 to ", most);
    GaussianView<float> v;
    v.mean = cloud->mean;
    v.rotation = cloud->rotation;
    v.scale = cloud->scale;
    v.opacity = cloud->opacity;
    v.feature = cloud->feature;
    v.size = static_cast<Index>(cloud->count);
    v.rows = v.stride = cloud->channels;
    if (v.size > 0) {
        check_pointer(v.mean.data, "cloud: mean");
        check_pointer(v.rotation.data, "cloud: rotation");
        check_pointer(v.scale.data, "cloud: scale");
        check_pointer(v.opacity.data, "cloud: opacity");
        check_pointer(v.feature, "cloud: feature");
    }
    return v;
}

void copy_out(const Columns<float>& from, float* to) {
    if (to != nullptr) std::copy_n(from.data(), from.size(), to);
}

/// Rows x pixels of the caller, or zeros.
Columns<float> copy_in(const float* from, Index rows, Index columns, const char* name) {
    if (from == nullptr) return Columns<float>::Zero(rows, columns);
    check_finite(from, rows * columns, name);
    return Eigen::Map<const Columns<float>>(from, rows, columns);
}

} // namespace

} // namespace rye::c

using namespace rye;
using namespace rye::c;

struct rye_renderer {
    ObjectThreads pool;
    AnyDrawing drawing;
    RasterScratch<float> scratch;
    Pinhole<float> camera;
    VecX<float> background;
    Index count = -1; ///< of the last image; negative: there is none
    Gaussians<float> gradient;

    explicit rye_renderer(const rye_options& o)
        : pool(o.threads),
          drawing(drawing_of(o.accuracy)) {}
    LibraryBackend backend() { return LibraryBackend{pool.threads()}; }
};

extern "C" {

uint32_t rye_c_version(void) { return RYE_C_VERSION; }

const char* rye_message(void) { return last_message(); }

rye_status rye_camera_look_at(const rye_look* look, rye_camera* camera) {
    return guarded([&] {
        check_struct(look, "look");
        check_struct(camera, "camera");
        check_finite(look->eye, 3, "look: eye");
        check_finite(look->target, 3, "look: target");
        check_finite(look->up, 3, "look: up");
        const auto vector = [](const float* v) { return Vec3<float>(v[0], v[1], v[2]); };
        const Pinhole<float> p =
            look_at<float>(vector(look->eye), vector(look->target), vector(look->up),
                           look->vertical_fov, {look->width, look->height});
        check_camera("rye_look", p);
        set_camera(p, *camera);
    });
}

rye_status rye_renderer_create(const rye_options* options, rye_renderer** renderer) {
    return guarded([&] {
        check_pointer(renderer, "renderer");
        *renderer = new rye_renderer(checked_options(options));
    });
}

void rye_renderer_destroy(rye_renderer* renderer) { delete renderer; }

rye_status rye_draw(rye_renderer* renderer, const rye_cloud* cloud, const rye_camera* camera,
                    const float* background, rye_image* image) {
    return guarded([&] {
        check_pointer(renderer, "renderer");
        check_pointer(background, "background");
        check_struct(image, "image");
        const GaussianView<float> view = view_of(cloud);
        const Pinhole<float> pinhole = camera_of(camera);
        check_finite(background, view.rows, "background");
        rye_renderer& r = *renderer;
        r.count = -1; // until the image is complete
        r.camera = pinhole;
        r.background = Eigen::Map<const VecX<float>>(background, view.rows);
        std::visit(
            [&](auto& d) {
                d.rasterizer.forward_into(r.backend(), view, r.camera, r.background, d.raster,
                                          &r.scratch);
                copy_out(d.raster.feature.pixels, image->feature);
                copy_out(d.raster.alpha.pixels, image->alpha);
                copy_out(d.raster.depth.pixels, image->depth);
                image->skipped = d.raster.trace.non_finite;
            },
            r.drawing);
        r.count = view.size;
    });
}

rye_status rye_draw_gradient(rye_renderer* renderer, const rye_cloud* cloud,
                             const rye_image_gradient* image, rye_cloud_gradient* gradient) {
    return guarded([&] {
        check_pointer(renderer, "renderer");
        check_struct(image, "image");
        check_struct(gradient, "gradient");
        const GaussianView<float> view = view_of(cloud);
        rye_renderer& r = *renderer;
        if (r.count != view.size || r.background.size() != view.rows)
            throw Failure(RYE_ERROR_STATE,
                          r.count < 0
                              ? "rye_draw_gradient: rye_draw has not drawn an image"
                              : "rye_draw_gradient: got a cloud of " + std::to_string(view.size) +
                                    " Gaussians, expected the " + std::to_string(r.count) +
                                    " of the last rye_draw");
        const Index pixels = static_cast<Index>(r.camera.width) * r.camera.height;
        const Columns<float> g_feature =
            copy_in(image->feature, view.rows, pixels, "image: feature");
        const Columns<float> g_alpha = copy_in(image->alpha, 1, pixels, "image: alpha");
        const Columns<float> g_depth = copy_in(image->depth, 1, pixels, "image: depth");
        std::visit(
            [&](auto& d) {
                d.rasterizer.vjp_into(r.backend(), view, r.camera, r.background, d.raster,
                                      {g_feature, image->alpha != nullptr ? &g_alpha : nullptr,
                                       image->depth != nullptr ? &g_depth : nullptr},
                                      r.gradient, &r.scratch);
            },
            r.drawing);
        copy_out(r.gradient.mean, gradient->mean);
        copy_out(r.gradient.rotation, gradient->rotation);
        copy_out(r.gradient.scale, gradient->scale);
        copy_out(r.gradient.opacity, gradient->opacity);
        copy_out(r.gradient.feature, gradient->feature);
    });
}

} // extern "C"
