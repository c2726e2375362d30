// SPDX-License-Identifier: Apache-2.0
/// rye/train/stage_avatar.hpp: one step of stage 2: three renders (final, face alone, eyes alone),
/// six losses, and their gradient with respect to every parameter of the avatar.
/// Images are sRGB in [0, 1] on the final background (white). Source: paper section 4.2; weights of
/// the image terms from GHA.
#pragma once

#include <algorithm>
#include <string>
#include <utility>

#include <rye/avatar/two_stream.hpp>
#include <rye/loss/dssim.hpp>
#include <rye/loss/perceptual.hpp>
#include <rye/loss/photometric.hpp>
#include <rye/splat/rasterizer.hpp>
#include <rye/train/probe.hpp>
#include <rye/train/samples.hpp>
#include <rye/train/settings.hpp>

namespace rye {

template <class T>
struct AvatarLosses {
    T high_resolution = T(0), low_resolution = T(0), perceptual = T(0), dssim = T(0);
    T eye_low = T(0), eye_high = T(0), blank = T(0), face_alone = T(0);
    T total = T(0);  ///< weighted
};

/// The pictures of a step and the cotangents of its losses.
template <class T>
struct AvatarPictures {
    Raster<T> final;              ///< feature render
    Raster<T> face;               ///< RGB of the face alone
    Raster<T> eyes;               ///< of the eyes alone: RGB, features if sample.eyes_high
    Image<T> scaled;              ///< the final feature render after the sample's random scale
    Image<T> high, eyes_high;     ///< after super-resolution
    UpsamplerTrace<T> high_trace, eyes_high_trace;
    Columns<T> g_high, g_eyes_high;                ///< weighted cotangents of the RGB images
    Columns<T> g_final, g_face, g_eyes;            ///< ... and of the feature renders
    RasterScratch<T> scratch;                      ///< memory that the renders share
    Gaussians<T> cloud, face_cloud, eye_cloud;     ///< of the three renders
    Gaussians<T> g_cloud, g_face_cloud, g_eye_cloud;
    bool eyes_from_eye_terms = false; ///< of the weights
};

template <class T, EffectSet E>
Drivers<T, E> corrected_drivers(const TwoStream<T, E>& avatar, const AvatarSample<T, E>& sample) {
    Drivers<T, E> drivers = sample.drivers;
    if constexpr (has_effect<E, ReadsHeadPose>)
        if (sample.frame >= 0) drivers.pose += avatar.delta_pose.col(sample.frame);
    if constexpr (has_effect<E, ReadsCamera>)
        drivers.camera = sample.camera.centre().template cast<T>();
    return drivers;
}

/// The same numbers without derivatives, in one colour.
template <class T>
Gaussians<T> painted(const Gaussians<T>& g, const VecX<T>& color) {
    Gaussians<T> r;
    Gaussians<T>::fields([](const std::string&, auto& out, const auto& in) {
        out = in.unaryExpr([](const T& v) { return T(value_of(v)); });
    }, r, g);
    r.feature = color.replicate(1, g.count());
    return r;
}

namespace detail {

/// weight * masked L1 of the first three rows; adds its cotangent to g (all rows).
template <Backend B, class T>
T rgb_term(const Columns<T>& prediction, const Columns<T>& truth, const Columns<T>& mask,
           double weight, Columns<T>& g) {
    const Columns<T> rgb = prediction.topRows(3);
    const LossGradient<T> l1 = masked_l1<B, T>(rgb, truth, mask);
    g.topRows(3) += T(weight) * l1.gradient;
    return l1.value;
}

/// The same Gaussians with their first channels only.
template <class T>
Gaussians<T> with_channels(const Gaussians<T>& g, Index channels) {
    Gaussians<T> r = g;
    r.feature = g.feature.topRows(channels);
    return r;
}

/// Adds the gradient of the first Gaussians and channels.
template <class T>
void add_first(Gaussians<T>& sum, const Gaussians<T>& g) {
    Gaussians<T>::fields([](const std::string&, auto& out, const auto& in) {
        const Index n = std::min(out.cols(), in.cols()), rows = std::min(out.rows(), in.rows());
        out.topLeftCorner(rows, n) += in.topLeftCorner(rows, n);
    }, sum, g);
}

template <class T>
double eye_gain(EyeAverage average, const Columns<T>& mask) {
    if (average == EyeAverage::image) return 1.0;
    double sum = 0;
    for (Index i = 0; i < mask.size(); ++i) sum += static_cast<double>(value_of(mask(0, i)));
    return sum > 0 ? static_cast<double>(mask.size()) / std::max(sum, 8.0) : 0.0;
}

} // namespace detail

/// What the face alone should show outside the eyes: the picture, over the blank's background.
template <class T, EffectSet E>
Columns<T> face_alone_truth(const AvatarSample<T, E>& sample) {
    const Vec3<T> change = sample.blank.template head<3>() - sample.background.template head<3>();
    return sample.truth_small.pixels +
           change * (Columns<T>::Ones(1, sample.mask_small.cols()) - sample.mask_small);
}

/// 1 where a visible pixel shows nothing of the eyes.
template <class T, EffectSet E>
Columns<T> face_alone_mask(const AvatarSample<T, E>& sample) {
    Columns<T> mask = sample.visible_small;
    for (Index i = 0; i < mask.cols(); ++i)
        if (sample.eyes_small(0, i) > T(0)) mask(0, i) = T(0);
    return mask;
}

/// 1 where a visible pixel shows an eye, or an eyeball would be seen if there were no face.
template <class T, EffectSet E>
Columns<T> eyeball_mask(const AvatarSample<T, E>& sample, const Columns<T>& eyeball_alpha) {
    Columns<T> mask = sample.visible_small;
    for (Index i = 0; i < mask.cols(); ++i)
        if (!(sample.eyes_small(0, i) > T(0)) && !(eyeball_alpha(0, i) > T(0.5))) mask(0, i) = T(0);
    return mask;
}

/// Renders and compares. Everything the vjp reads stays in `trace` and `pictures`.
template <Backend B, class Accuracy, class Perceptual, class T, EffectSet E,
          class Probe = NoProbe>
AvatarLosses<T> avatar_losses(const TwoStream<T, E>& avatar, const AvatarConfig& config,
                              const LandmarkRoles& roles, const AvatarLossConfig& weights,
                              const Rasterizer<B, Accuracy>& rasterizer,
                              const Perceptual& perceptual, const AvatarSample<T, E>& sample,
                              TwoStreamTrace<T, E>& trace, AvatarPictures<T>& pictures,
                              Probe&& probe = {}) {
    drive<B>(avatar, config, roles, corrected_drivers(avatar, sample), trace);
    probe("networks");
    AvatarPictures<T>& p = pictures;
    p.cloud = joined(trace.world_face, trace.world_eyes);
    rasterizer.forward_into(p.cloud, sample.camera, sample.background, p.final, &p.scratch);
    const VecX<T> blank_color = sample.blank.head(3);
    p.face_cloud = detail::with_channels(trace.world_face, 3);
    p.eyes_from_eye_terms = weights.eyes_from_eye_terms;
    if (weights.blank_eyeballs)
        p.face_cloud = joined(p.face_cloud, painted(trace.world_eyes, blank_color));
    rasterizer.forward_into(p.face_cloud, sample.camera, blank_color, p.face, &p.scratch);
    // Only super-resolution reads more than RGB.
    p.eye_cloud = detail::with_channels(
        trace.world_eyes, sample.eyes_high ? trace.world_eyes.channels() : Index(3));
    const VecX<T> behind_eyes = sample.background.head(p.eye_cloud.channels());
    rasterizer.forward_into(p.eye_cloud, sample.camera, behind_eyes, p.eyes, &p.scratch);
    probe("render");
    p.scaled = p.final.feature;
    if (sample.scale.active())
        p.scaled.pixels = gathered(p.final.feature.pixels, sample.scale.small);
    p.high = upsampler_forward<B>(avatar.upsampler, p.scaled, &p.high_trace);
    if (sample.eyes_high)
        p.eyes_high = upsampler_forward<B>(avatar.upsampler, p.eyes.feature, &p.eyes_high_trace);
    else
        p.eyes_high = {};
    probe("super-resolution");

    const auto zero = [](const Image<T>& i) { return Columns<T>::Zero(i.channels(), i.size()); };
    p.g_high = zero(p.high);
    p.g_eyes_high = zero(p.eyes_high);
    p.g_final = zero(p.final.feature);
    p.g_face = zero(p.face.feature);
    p.g_eyes = zero(p.eyes.feature);

    AvatarLosses<T> l;
    Image<T> truth = sample.truth;
    truth.pixels = gathered(sample.truth.pixels, sample.scale.full);
    l.high_resolution = detail::rgb_term<B>(p.high.pixels, truth.pixels,
                                            gathered(sample.visible, sample.scale.full),
                                            weights.high_resolution, p.g_high);
    l.low_resolution =
        detail::rgb_term<B>(p.final.feature.pixels, sample.truth_small.pixels,
                            sample.visible_small, weights.low_resolution, p.g_final);
    const LossGradient<T> seen = perceptual(p.high, truth);
    l.perceptual = seen.value;
    p.g_high += T(weights.perceptual) * seen.gradient;

    if (weights.dssim > 0) {
        const LossGradient<T> structure = dssim<B, T>(p.high, truth);
        l.dssim = structure.value;
        p.g_high += T(weights.dssim) * structure.gradient;
    }

    const double small_gain = detail::eye_gain(weights.eye_average, sample.eyes_small);
    const double gain = detail::eye_gain(weights.eye_average, sample.eyes);
    l.eye_low = T(small_gain) *
                detail::rgb_term<B>(p.eyes.feature.pixels, sample.truth_small.pixels,
                                    sample.eyes_small, weights.eye_low * small_gain, p.g_eyes);
    const double eye_high = sample.eyes_high ? weights.eye_high * weights.eye_high_every : 0.0;
    if (sample.eyes_high)
        l.eye_high = T(gain) * detail::rgb_term<B>(p.eyes_high.pixels, sample.truth.pixels,
                                                   sample.eyes, eye_high * gain, p.g_eyes_high);
    Columns<T> blank = blank_color.replicate(1, p.face.feature.size());
    Columns<T> blank_mask = sample.eyes_small;
    if (weights.blank_eyeballs) {
        const Columns<T> picture = face_alone_truth(sample);
        for (Index i = 0; i < blank.cols(); ++i)
            blank.col(i) =
                picture.col(i) + sample.eyes_small(0, i) * (blank_color - picture.col(i));
        blank_mask = eyeball_mask(sample, p.eyes.alpha.pixels);
    }
    const double blank_gain = detail::eye_gain(weights.eye_average, blank_mask);
    l.blank = T(blank_gain) * detail::rgb_term<B>(p.face.feature.pixels, blank, blank_mask,
                                                  weights.blank * blank_gain, p.g_face);
    if (weights.face_alone > 0)
        l.face_alone = detail::rgb_term<B>(p.face.feature.pixels, face_alone_truth(sample),
                                           face_alone_mask(sample), weights.face_alone, p.g_face);
    l.total = T(weights.high_resolution) * l.high_resolution +
              T(weights.low_resolution) * l.low_resolution + T(weights.perceptual) * l.perceptual +
              T(weights.dssim) * l.dssim +
              T(weights.eye_low) * l.eye_low + T(eye_high) * l.eye_high +
              T(weights.blank) * l.blank + T(weights.face_alone) * l.face_alone;
    probe("losses");
    return l;
}

/// Adds dL/dparameters to `grad`.
template <Backend B, class Accuracy, class T, EffectSet E, class Probe = NoProbe>
void avatar_losses_vjp(const TwoStream<T, E>& avatar, const AvatarConfig& config,
                       const Rasterizer<B, Accuracy>& rasterizer, const AvatarSample<T, E>& sample,
                       const TwoStreamTrace<T, E>& trace, AvatarPictures<T>& p,
                       TwoStream<T, E>& grad,
                       Probe&& probe = {}) {
    Columns<T> g_feature;
    upsampler_vjp<B>(avatar.upsampler, p.scaled, p.high_trace, p.g_high, grad.upsampler,
                     &g_feature);
    gathered_vjp(g_feature, sample.scale.small, p.g_final);
    if (sample.eyes_high) {
        upsampler_vjp<B>(avatar.upsampler, p.eyes.feature, p.eyes_high_trace, p.g_eyes_high,
                         grad.upsampler, &g_feature);
        p.g_eyes += g_feature;
    }
    probe("super-resolution vjp");

    const Index n = trace.world_face.mean.cols();
    const auto pull = [&](const Gaussians<T>& cloud, const VecX<T>& background,
                          const Raster<T>& raster, const Columns<T>& g) {
        rasterizer.vjp_into(cloud, sample.camera, background, raster, RasterCotangent<T>{g},
                            p.g_cloud, &p.scratch);
    };
    pull(p.cloud, sample.background, p.final, p.g_final);
    p.g_face_cloud = part(p.g_cloud, 0, n);
    p.g_eye_cloud = part(p.g_cloud, n, p.g_cloud.mean.cols() - n);
    if (p.eyes_from_eye_terms) // where they are is the joint picture's still: it moves the head
        for (Columns<T>* g : {&p.g_eye_cloud.rotation, &p.g_eye_cloud.scale,
                              &p.g_eye_cloud.opacity, &p.g_eye_cloud.feature})
            g->setZero();
    pull(p.face_cloud, VecX<T>(sample.blank.head(3)), p.face, p.g_face);
    detail::add_first(p.g_face_cloud, p.g_cloud);
    pull(p.eye_cloud, VecX<T>(sample.background.head(p.eye_cloud.channels())), p.eyes, p.g_eyes);
    detail::add_first(p.g_eye_cloud, p.g_cloud);
    probe("render vjp");

    const Drivers<T, E> drivers = corrected_drivers(avatar, sample);
    const Vec<T, 6> g_pose = drive_vjp<B>(avatar, config, drivers, trace, p.g_face_cloud,
                                             p.g_eye_cloud, grad);
    if constexpr (has_effect<E, ReadsHeadPose>)
        if (sample.frame >= 0) grad.delta_pose.col(sample.frame) += g_pose;
    probe("networks vjp");
}

} // namespace rye
