// SPDX-License-Identifier: Apache-2.0
#include "drawing/shown.hpp"

#include <rye/avatar/hold.hpp>
#include <rye/loss/ssim.hpp>

#include "data/panel.hpp"
#include "model/trained_parts.hpp"

namespace rye::trainer {

Image<float> of_camera(Image<float> picture, const Pinhole<float>& camera) {
    if (picture.width == camera.width && picture.height == camera.height) return picture;
    return cropped(picture, 0, 0, camera.width, camera.height);
}

Drivers<float, TrainEffects> all_drivers(const DrawnFrame& frame, const Pinhole<float>& camera) {
    Drivers<float, TrainEffects> d = seen_from(restricted<TrainEffects>(frame.drivers), camera);
    d.pupil = frame.pupil;
    return d;
}

namespace {

/// Throws an Error for numbers that are not finite: they draw nothing, or anything.
void require_drawable(const Gaussians<float>& g) {
    Gaussians<float>::fields([](const std::string& name, const auto& a) {
        require(a.allFinite(), "the driven Gaussians",
                "their '" + name + "' is not finite everywhere; the run is damaged, or its drivers "
                "are far from those of its training");
    }, g);
}

/// Returns the driven Gaussians of the state's avatar.
TwoStreamGaussians<float> driven(const TrainState& state,
                                 const Drivers<float, TrainEffects>& drivers) {
    const AvatarConfig& config = state.config.avatar;
    const LandmarkRoles& roles = state.subject.roles;
    if (state.compared)
        return driven_compared(state.compared->avatar, config, roles, drivers);
    TwoStreamTrace<float, TrainEffects> trace;
    drive(train_backend(), state.avatar, {config, roles, drivers}, trace);
    return trace;
}

} // namespace

AvatarView render_avatar(const TrainState& state, const DrawnFrame& frame, bool streams) {
    const TrainConfig& config = state.config;
    const int factor = 1 << config.gaussians.upsampler.doublings;
    const Pinhole<float> small = reduced(frame.camera, factor);
    const TwoStreamGaussians<float> trace = driven(state, all_drivers(frame, small));
    require_drawable(trace.gaussians);
    const VecX<float> white = VecX<float>::Ones(config.avatar.channels);
    const TrainRasterizer rasterizer = train_rasterizer(frame.dilation);
    AvatarView v;
    v.final = rasterizer.forward(train_backend(), trace.gaussians, small, white).feature;
    if (streams) {
        v.face = rasterizer.forward(train_backend(), trace.face_gaussians(), small, white).feature;
        v.eyes = rasterizer.forward(train_backend(), trace.eye_gaussians(), small, white).feature;
    }
    v.high = of_camera(upsampler_forward(train_backend(), state.avatar.upsampler, v.final, nullptr),
                       frame.camera);
    return v;
}

Image<float> picture_of(const TrainState& state, const Gaussians<float>& driven,
                        const Pinhole<float>& camera, double dilation) {
    const TrainConfig& config = state.config;
    const Pinhole<float> small = reduced(camera, 1 << config.gaussians.upsampler.doublings);
    const VecX<float> white = VecX<float>::Ones(config.avatar.channels);
    require_drawable(driven);
    const Image<float> render =
        train_rasterizer(dilation).forward(train_backend(), driven, small, white).feature;
    return of_camera(upsampler_forward(train_backend(), state.avatar.upsampler, render, nullptr),
                     camera);
}

std::array<Vec3<double>, 2> posed_centres(const TrainState& state, const Drivers<float>& drivers) {
    const Avatar& avatar = state.avatar;
    const AvatarConfig& config = state.config.avatar;
    const OpticalDrivers<float> optical = optical_drivers(state, drivers);
    const HeadTransform<float> head = head_transform(optical.drivers);
    EyeOffsetTrace<float> offset;
    const Columns<float> centre =
        avatar.eyes.centre + eye_offset<float>(train_backend(), avatar.eyes.offset, config,
                                               frame_code(config, optical), offset);
    std::array<Vec3<double>, 2> world;
    for (Index e = 0; e < 2; ++e) {
        const Vec3<float> c = head.scale * (head.rotation * centre.col(e));
        world[static_cast<std::size_t>(e)] = (c + head.translation).cast<double>();
    }
    return world;
}

namespace {

/// Returns the area of PosedEyes for driven Gaussians, whose features are overwritten.
Image<float> eyes_area(const TrainState& state, TwoStreamGaussians<float>& shown,
                       const DrawnFrame& frame) {
    const Avatar& avatar = state.avatar;
    Gaussians<float>& both = shown.gaussians;
    both.feature = Columns<float>::Zero(2, both.count());
    for (Index e = 0; e < 2; ++e)
        both.feature.row(e)
            .segment(shown.face_count + avatar.eyes.first_point(e), avatar.eyes.points_of(e))
            .setOnes();
    const VecX<float> nothing = VecX<float>::Zero(2);
    return train_rasterizer(frame.dilation)
        .forward(train_backend(), both, frame.camera, nothing)
        .feature;
}

} // namespace

PosedEyes posed_eyes(const TrainState& state, const DrawnFrame& frame) {
    TwoStreamGaussians<float> shown = driven(state, all_drivers(frame, frame.camera));
    return {posed_centres(state, frame.drivers), eyes_area(state, shown, frame)};
}

ShownAvatar shown_avatar(const TrainState& state, const DrawnFrame& frame) {
    TwoStreamGaussians<float> shown = driven(state, all_drivers(frame, frame.camera));
    ShownAvatar r;
    r.picture = picture_of(state, shown.gaussians, frame.camera, frame.dilation);
    r.eyes = {posed_centres(state, frame.drivers), eyes_area(state, shown, frame)};
    return r;
}

Gaussians<float> driven_gaussians(const TrainState& state,
                                  const Drivers<float, TrainEffects>& drivers) {
    TwoStreamGaussians<float> shown = driven(state, drivers);
    require_drawable(shown.gaussians);
    return std::move(shown.gaussians);
}

Gaussians<float> driven_gaussians(const TrainState& state, const Drivers<float>& drivers) {
    const auto plain = restricted<TrainEffects>(drivers);
    if (!state.avatar.eyes.optics.sees_cornea() && !state.avatar.has_view_color())
        return driven_gaussians(state, plain);
    TrainState without = state;
    without.avatar.eyes.optics = {};
    without.avatar.view_color = {};
    return driven_gaussians(without, plain);
}

Image<float> rgb_of(const Image<float>& feature) {
    Image<float> rgb;
    rgb.width = feature.width;
    rgb.height = feature.height;
    rgb.pixels = feature.pixels.topRows(3);
    return rgb;
}

double masked_ssim(const Image<float>& a, const Image<float>& b, const Columns<float>& area) {
    return ssim(train_backend(), a, b, area);
}

} // namespace rye::trainer
