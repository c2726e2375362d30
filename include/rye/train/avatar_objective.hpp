// SPDX-License-Identifier: Apache-2.0
/// rye/train/avatar_objective.hpp: the objective of stage 2: three renders of the driven Gaussians
/// (final, face alone, eyes alone), six losses, and their gradients with respect to the Gaussians
/// and the upsampler. It does not depend on the avatar's effects. Images are sRGB in [0, 1] on the
/// final background (white). Source: paper section 4.2; weights of the image terms from GHA.
#pragma once

#include <algorithm>
#include <initializer_list>
#include <string>
#include <vector>

#include <rye/avatar/two_stream.hpp>
#include <rye/loss/dssim.hpp>
#include <rye/loss/perceptual.hpp>
#include <rye/loss/photometric.hpp>
#include <rye/splat/rasterizer.hpp>
#include <rye/train/face_pixels.hpp>
#include <rye/train/probe.hpp>
#include <rye/train/samples.hpp>
#include <rye/train/settings.hpp>

namespace rye {

/// Terms of the second stage's objective, unweighted except for the total; 0 for those that are
/// off.
template <class T>
struct AvatarLosses {
    T high_resolution = T(0), low_resolution = T(0), perceptual = T(0), dssim = T(0);
    T eye_low = T(0), eye_high = T(0), blank = T(0), face_alone = T(0), eye_smooth = T(0);
    T face_smooth = T(0), face_mirror = T(0);
    T total = T(0);  ///< weighted

    /// Calls f(name, value...) for each term, by its name in logs, and for the total, "loss", last.
    template <class F, class... L>
    static void fields(F&& f, L&&... l) {
        f("high_resolution", l.high_resolution...);
        f("low_resolution", l.low_resolution...);
        f("perceptual", l.perceptual...);
        f("dssim", l.dssim...);
        f("eye_low", l.eye_low...);
        f("eye_high", l.eye_high...);
        f("blank", l.blank...);
        f("face_alone", l.face_alone...);
        f("eye_smooth", l.eye_smooth...);
        f("face_smooth", l.face_smooth...);
        f("face_mirror", l.face_mirror...);
        f("loss", l.total...);
    }
};

/// Pictures of a step and cotangents of its losses. U: the super-resolution network.
template <class T, class U = Upsampler<T>>
struct AvatarPictures {
    Raster<T, features_only> final;  ///< the feature render of all
    Raster<T, features_only> face;   ///< RGB of the face alone
    Raster<T, features_only> eyes;   ///< the eyes alone: RGB, all features if sample.eyes_high
    Image<T> scaled;              ///< `final` after the sample's random scale, if any
    Image<T> high, eyes_high;     ///< after super-resolution
    typename U::Trace high_trace, eyes_high_trace;
    Columns<T> g_high, g_eyes_high;                ///< weighted cotangents of the RGB images
    Columns<T> g_final, g_face, g_eyes;            ///< weighted cotangents of the feature renders
    RasterScratch<T> scratch;                      ///< memory shared by the renders
    Gaussians<T> g_gaussians, g_part;              ///< of all Gaussians; of one render's
    VecX<T> blank, behind_eyes;       ///< backgrounds: of the face alone, of the eyes alone
};

namespace detail {

/// Returns the masked L1 of the first three rows; adds `weight` times its cotangent to those of g.
template <class T, Backend B>
T rgb_term(const B& backend, const Columns<T>& prediction, const Columns<T>& truth,
           const std::type_identity_t<WeightedMask<T>>& mask, Columns<T>& g) {
    return add_masked_l1<T>(backend, prediction.topRows(3), truth, mask, g.topRows(3));
}

/// Calls f(begin, end) for chunks of the columns of an image.
template <class F, Backend B>
void over_pixels(const B& backend, Index pixels, const F& f) {
    for_chunks(backend.threads, pixels, loss_grain, [&](Index b, Index e, Index) { f(b, e); });
}

/// Adds weight * g to sum.
template <class T, Threads P>
void add_weighted(const P& threads, std::type_identity_t<ColumnsSpan<T>> sum, const T& weight,
                  const Columns<T>& g) {
    for_chunks(threads, sum.cols(), loss_grain, [&](Index b, Index e, Index) {
        sum.middleCols(b, e - b) += weight * g.middleCols(b, e - b);
    });
}

/// An image, and its cotangent.
template <class T>
struct ImageCotangent {
    const Image<T>& image;
    Columns<T>& g;
};

/// Sets cotangents to zeros of the shape of their images, all side by side.
template <class T, Backend B>
void zero_like(const B& backend, std::initializer_list<ImageCotangent<T>> all) {
    std::vector<ArrayWork> work;
    for (const ImageCotangent<T>& one : all) {
        Columns<T>& g = one.g;
        g.resize(one.image.channels(), one.image.size());
        work.push_back(
            {g.size(), [&g](Index b, Index e) { std::fill_n(g.data() + b, e - b, T(0)); }});
    }
    for_chunks(backend.threads, work, 16384);
}

/// Returns the face alone, in RGB.
template <class T>
GaussianView<T> face_view(const TwoStreamGaussians<T>& driven) {
    return driven.face_gaussians().first_channels(3);
}

/// Returns the eyes alone, with as many channels as their background.
template <class T, class U>
GaussianView<T> eye_view(const TwoStreamGaussians<T>& driven, const AvatarPictures<T, U>& p) {
    return driven.eye_gaussians().first_channels(p.behind_eyes.size());
}

/// Adds the gradient of a render of the Gaussians in a range of sum's columns, with as many
/// channels as `g` has.
template <class T, Backend B>
void add_part(const B& backend, Gaussians<T>& sum, ColumnRange range, const Gaussians<T>& g) {
    for_chunks(backend.threads, range.count, 512, [&](Index b, Index e, Index) {
        Gaussians<T>::fields([&](const std::string&, auto& out, const auto& in) {
            for (Index i = b; i < e; ++i)
                for (Index r = 0; r < in.rows(); ++r) out(r, range.begin + i) += in(r, i);
        }, sum, g);
    });
}

/// Target of the face alone: three rows of colours and one of weights.
template <class T>
struct FaceTarget {
    Columns<T> picture, mask;

    explicit FaceTarget(Index pixels) : picture(3, pixels), mask(1, pixels) {}
};

} // namespace detail

/// Returns the picture over the blank's background, with weight 1 where a visible pixel shows
/// nothing of the eyes.
template <class T, Backend B>
detail::FaceTarget<T> face_alone_target(const B& backend, const AvatarImages<T>& sample) {
    const Vec3<T> change = sample.blank.template head<3>() - sample.background.template head<3>();
    detail::FaceTarget<T> t(sample.mask_small.cols());
    detail::over_pixels(backend, t.mask.cols(), [&](Index b, Index e) {
        for (Index i = b; i < e; ++i) {
            const T beyond = T(1) - sample.mask_small(0, i);
            for (Index c = 0; c < 3; ++c)
                t.picture(c, i) = detail::face_alone_colour<T>(sample.truth_small.pixels(c, i),
                                                               change(c), beyond);
            t.mask(0, i) =
                detail::face_alone_weight<T>(sample.eyes_small(0, i), sample.visible_small(0, i));
        }
    });
    return t;
}

namespace detail {

/// Returns the input of super-resolution.
template <class T, class U>
const Image<T>& features_shown(const AvatarImages<T>& sample, const AvatarPictures<T, U>& p) {
    return sample.scale.active() ? p.scaled : p.final.feature;
}

} // namespace detail

/// Objective of stage 2: renders, compares, and propagates the losses back to the Gaussians.
template <AccuracyPolicy A = Balanced, class Perceptual = PyramidGradientLoss>
struct AvatarObjective {
    AvatarLossConfig weights = {};
    Rasterizer<FeaturesOnly<A>> rasterizer = {};
    Perceptual perceptual = {};

    /// Returns the losses; keeps everything that vjp reads in `p`.
    template <class T, class U, class Probe = NoProbe, Backend B>
    AvatarLosses<T> value(const B& backend, const U& upsampler, const AvatarImages<T>& sample,
                          const TwoStreamGaussians<T>& driven, AvatarPictures<T, U>& p,
                          Probe&& probe = {}) const;

    /// Sets p.g_gaussians, the gradient of the driven Gaussians; adds to the upsampler's gradient.
    template <class T, class U, class Probe = NoProbe, Backend B>
    void vjp(const B& backend, const U& upsampler, const AvatarImages<T>& sample,
             const TwoStreamGaussians<T>& driven, AvatarPictures<T, U>& p, U& g_upsampler,
             Probe&& probe = {}) const;
};

template <AccuracyPolicy A, class Perceptual>
template <class T, class U, class Probe, Backend B>
AvatarLosses<T> AvatarObjective<A, Perceptual>::value(
    const B& backend, const U& upsampler, const AvatarImages<T>& sample,
    const TwoStreamGaussians<T>& driven, AvatarPictures<T, U>& p, Probe&& probe) const {
    p.blank = sample.blank.head(3);
    // Only super-resolution reads more than RGB.
    p.behind_eyes =
        sample.background.head(sample.eyes_high ? driven.gaussians.channels() : Index(3));
    const Rasterizer<FeaturesOnly<A>>& draw = rasterizer;
    draw.forward_into(backend, driven.gaussians, sample.camera, sample.background, p.final,
                      &p.scratch);
    draw.forward_into(backend, detail::face_view(driven), sample.camera, p.blank, p.face,
                      &p.scratch);
    draw.forward_into(backend, detail::eye_view(driven, p), sample.camera, p.behind_eyes, p.eyes,
                      &p.scratch);
    probe("render");
    if (sample.scale.active()) {
        p.scaled.width = p.final.feature.width;
        p.scaled.height = p.final.feature.height;
        p.scaled.pixels = detail::gathered(p.final.feature.pixels, sample.scale.small);
    }
    p.high =
        upsampler_forward(backend, upsampler, detail::features_shown(sample, p), &p.high_trace);
    if (sample.eyes_high)
        p.eyes_high =
            upsampler_forward(backend, upsampler, p.eyes.feature, &p.eyes_high_trace);
    else
        p.eyes_high = {};
    probe("super-resolution");

    detail::zero_like<T>(backend, {{p.high, p.g_high},
                                   {p.eyes_high, p.g_eyes_high},
                                   {p.final.feature, p.g_final},
                                   {p.face.feature, p.g_face},
                                   {p.eyes.feature, p.g_eyes}});

    AvatarLosses<T> l;
    Image<T> moved;
    Columns<T> moved_visible;
    if (sample.scale.active()) {
        moved = sample.truth;
        moved.pixels = detail::gathered(sample.truth.pixels, sample.scale.full);
        moved_visible = detail::gathered(sample.visible, sample.scale.full);
    }
    const Image<T>& truth = sample.scale.active() ? moved : sample.truth;
    l.high_resolution = detail::rgb_term(
        backend, p.high.pixels, truth.pixels,
        {sample.scale.active() ? moved_visible : sample.visible, T(weights.high_resolution)},
        p.g_high);
    l.low_resolution =
        detail::rgb_term(backend, p.final.feature.pixels, sample.truth_small.pixels,
                         {sample.visible_small, T(weights.low_resolution)}, p.g_final);
    const LossGradient<T> seen = perceptual(backend, p.high, truth);
    l.perceptual = seen.value;
    detail::add_weighted<T>(backend.threads, p.g_high, T(weights.perceptual), seen.gradient);

    if (weights.dssim > 0) {
        const LossGradient<T> structure = dssim<T>(backend, p.high, truth);
        l.dssim = structure.value;
        detail::add_weighted<T>(backend.threads, p.g_high, T(weights.dssim), structure.gradient);
    }

    l.eye_low = detail::rgb_term(backend, p.eyes.feature.pixels, sample.truth_small.pixels,
                                 {sample.eyes_small, T(weights.eye_low)}, p.g_eyes);
    const double eye_high = sample.eyes_high ? weights.eye_high * weights.eye_high_every : 0.0;
    if (sample.eyes_high)
        l.eye_high = detail::rgb_term(backend, p.eyes_high.pixels, sample.truth.pixels,
                                      {sample.eyes, T(eye_high)}, p.g_eyes_high);
    Columns<T> blank(3, p.face.feature.size());
    detail::over_pixels(backend, blank.cols(), [&](Index b, Index e) {
        blank.middleCols(b, e - b).colwise() = p.blank.template head<3>();
    });
    l.blank = detail::rgb_term(backend, p.face.feature.pixels, blank,
                               {sample.eyes_small, T(weights.blank)}, p.g_face);
    if (weights.face_alone > 0) {
        const detail::FaceTarget<T> alone = face_alone_target(backend, sample);
        l.face_alone = detail::rgb_term(backend, p.face.feature.pixels, alone.picture,
                                        {alone.mask, T(weights.face_alone)}, p.g_face);
    }
    l.total = T(weights.high_resolution) * l.high_resolution +
              T(weights.low_resolution) * l.low_resolution + T(weights.perceptual) * l.perceptual +
              T(weights.dssim) * l.dssim +
              T(weights.eye_low) * l.eye_low + T(eye_high) * l.eye_high +
              T(weights.blank) * l.blank + T(weights.face_alone) * l.face_alone;
    probe("losses");
    return l;
}

template <AccuracyPolicy A, class Perceptual>
template <class T, class U, class Probe, Backend B>
void AvatarObjective<A, Perceptual>::vjp(
    const B& backend, const U& upsampler, const AvatarImages<T>& sample,
    const TwoStreamGaussians<T>& driven, AvatarPictures<T, U>& p, U& g_upsampler,
    Probe&& probe) const {
    Columns<T> g_feature;
    upsampler_vjp(backend, upsampler, detail::features_shown(sample, p), p.high_trace, p.g_high,
                  g_upsampler, &g_feature);
    if (sample.scale.active())
        detail::gathered_vjp(g_feature, sample.scale.small, p.g_final);
    else
        detail::add_weighted<T>(backend.threads, p.g_final, T(1), g_feature);
    if (sample.eyes_high) {
        upsampler_vjp(backend, upsampler, p.eyes.feature, p.eyes_high_trace, p.g_eyes_high,
                      g_upsampler, &g_feature);
        detail::add_weighted<T>(backend.threads, p.g_eyes, T(1), g_feature);
    }
    probe("super-resolution vjp");

    const auto pull = [&](const GaussianView<T>& view, const VecX<T>& background,
                          const Raster<T, features_only>& raster, const Columns<T>& g,
                          Gaussians<T>& to) {
        rasterizer.vjp_into(backend, view, sample.camera, background, raster, RasterCotangent<T>{g},
                            to, &p.scratch);
    };
    pull(driven.gaussians, sample.background, p.final, p.g_final, p.g_gaussians);
    pull(detail::face_view(driven), p.blank, p.face, p.g_face, p.g_part);
    detail::add_part(backend, p.g_gaussians, driven.face_columns(), p.g_part);
    pull(detail::eye_view(driven, p), p.behind_eyes, p.eyes, p.g_eyes, p.g_part);
    detail::add_part(backend, p.g_gaussians, driven.eye_columns(), p.g_part);
    probe("render vjp");
}

} // namespace rye
