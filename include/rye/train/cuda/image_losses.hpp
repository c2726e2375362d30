// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/image_losses.hpp: image terms of stage 2's objective over renders in device
/// memory, value and cotangent together: the part of train/avatar_objective.hpp between
/// super-resolution and its vjp. Truth and masks are floats, or bytes as in picture files.
///     DeviceImageLosses<CudaDevice> losses(device, weights);
///     losses.into(queue, images, pictures, cotangents);      // nothing waits
///     losses.report_into(queue);
///     AvatarLosses<float> l = losses.fetch(queue);           // waits
#pragma once

#include <string>
#include <vector>

#include <rye/backend/cuda/branches.hpp>
#include <rye/loss/cuda/dssim.hpp>
#include <rye/loss/cuda/pyramid.hpp>
#include <rye/loss/cuda/rgb_term.hpp>
#include <rye/train/avatar_objective.hpp>
#include <rye/train/cuda/resize.hpp>

namespace rye {

/// AvatarImages in device memory. P: float, or std::uint8_t with 255 for 1. Masks: 1 x pixels.
template <class P>
struct DeviceAvatarImages {
    DevicePicture<const P> truth, truth_small; ///< RGB on the final background
    const P *visible, *visible_small;
    const P *eyes, *eyes_small;
    const P* mask_small;
    bool eyes_high = true;
    const detail::Resizing* scale = nullptr; ///< of the small image, in device memory; may be null
    const float* background = nullptr;       ///< of the final render, first three channels
    const float* blank = nullptr;            ///< of the face alone, 3
};

/// Renders and their super-resolution; eyes_high has no pixels if that term is off.
struct DeviceAvatarPictures {
    DeviceColumns<const float> final, face, eyes; ///< at least three channels x pixels
    DevicePicture<const float> high, eyes_high;
};
/// Cotangents of DeviceAvatarPictures, of the same shapes; overwritten.
struct DeviceAvatarCotangents {
    DeviceColumns<float> final, face, eyes;
    DevicePicture<float> high, eyes_high;
};

/// Target of face_alone_target, pixel by pixel.
template <class P>
struct FaceAloneTarget {
    const P *truth, *visible, *eyes, *subject;
    const float *background, *blank;

    RYE_HD float mask(Index i) const {
        return detail::face_alone_weight<float>(unit_value(eyes[i]), unit_value(visible[i]));
    }
    RYE_HD Array<float, 3> colour(Index i) const {
        const float beyond = 1.0F - unit_value(subject[i]);
        Array<float, 3> r{};
        for (std::size_t c = 0; c < 3; ++c)
            r[c] = detail::face_alone_colour<float>(unit_value(truth[3 * i + Index(c)]),
                                                    blank[c] - background[c], beyond);
        return r;
    }
    RYE_HD RgbTarget at(Index i) const { return {mask(i), colour(i)}; }
};

/// Target of the blank's background in the eyes.
template <class P>
struct BlankTarget {
    const P* eyes;
    const float* blank;

    RYE_HD float mask(Index i) const { return unit_value(eyes[i]); }
    RYE_HD RgbTarget at(Index i) const { return {mask(i), {{blank[0], blank[1], blank[2]}}}; }
};

/// Returns the losses of a report, whose values are in the order of AvatarLosses' fields.
inline AvatarLosses<float> avatar_losses(const LossReport& report) {
    AvatarLosses<float> l;
    int k = 0;
    AvatarLosses<float>::fields([&](const char*, float& value) { value = report.value[k++]; }, l);
    l.total = report.total; // the last field, of which the report has no value
    return l;
}

/// Terms of the objective and their memory. Perceptual: a term of two pictures, as
/// DevicePyramidLoss.
template <class Device, class Perceptual = DevicePyramidLoss<Device>>
class DeviceImageLosses {
  public:
    DeviceImageLosses(const Device& device, const AvatarLossConfig& config, Perceptual& perceptual)
        : weights(config),
          device_(device),
          perceptual_(&perceptual),
          dssim_(device),
          high_(device),
          low_(device),
          eye_low_(device),
          eye_high_(device),
          blank_(device),
          alone_(device),
          report_(device) {}

    AvatarLossConfig weights;

    /// Returns the memory held [bytes], without the perceptual term's.
    std::size_t bytes() const {
        std::size_t sum = dssim_.bytes() + moved_.bytes() + report_.bytes();
        for (const auto* term : {&high_, &low_, &eye_low_, &eye_high_, &blank_, &alone_})
            sum += term->bytes();
        return sum;
    }

    /// Enqueues all image terms and their cotangents. Throws an Error for shapes that do not fit.
    template <class P>
    void into(const CudaQueue& queue, const DeviceAvatarImages<P>& images,
              const DeviceAvatarPictures& p, const DeviceAvatarCotangents& g) {
        check(images, p, g);
        terms_.assign(without_face, DeviceLossTerm{});
        branches_.run(queue, 3, [&](std::size_t k, const CudaQueue& q) {
            if (k == 0) picture_terms(q, images, p, g);
            if (k == 1) render_terms(q, images, p, g);
            if (k == 2) eyes_high_term(q, images, p, g);
        });
    }
    /// Adds a term that is not of images: the smoothness of the eyes' colours. Call it between
    /// into() and report_into().
    void add_eye_smooth(const DeviceLossTerm& term) { terms_[8] = term; }
    /// Adds the smoothness and the mirrored likeness of the face's features, as add_eye_smooth.
    void add_face(const DeviceLossTerm& smooth, const DeviceLossTerm& mirror) {
        terms_.resize(terms);
        terms_[9] = smooth, terms_[10] = mirror;
    }
    /// Enqueues the report of values and total, which stays on the device.
    void report_into(const CudaQueue& queue) { report_.sum_into(queue, terms_); }

    /// Returns the values of the last report; waits. Sets `bad` to the name of the first term that
    /// is not finite, or to empty.
    AvatarLosses<float> fetch(const CudaQueue& queue, std::string& bad) const {
        const LossReport r = report_.fetch(queue);
        bad = r.finite() ? "" : names[r.bad];
        return avatar_losses(r);
    }
    /// Returns the report in device memory.
    const LossReport* report() const { return report_.data(); }

  private:
    static constexpr int without_face = 9, terms = 11; ///< a report of the former has 0 beyond
    static constexpr const char* names[terms] = {"high_resolution", "low_resolution", "perceptual",
                                                 "dssim",           "eye_low",        "eye_high",
                                                 "blank",           "face_alone",     "eye_smooth",
                                                 "face_smooth",     "face_mirror"};

    /// Enqueues the terms of the final picture.
    template <class P>
    void picture_terms(const CudaQueue& queue, const DeviceAvatarImages<P>& images,
                       const DeviceAvatarPictures& p, const DeviceAvatarCotangents& g) {
        clear(queue, g.high.pixels);
        const DeviceAvatarImages<P> seen = images.scale != nullptr ? moved(queue, images) : images;
        terms_[0] =
            high_.into(queue, p.high.pixels, PictureTarget<P>{seen.truth.pixels.data, seen.visible},
                       weights.high_resolution, g.high.pixels);
        terms_[2] = perceptual_->into(queue, p.high, seen.truth, weights.perceptual, g.high);
        if (weights.dssim > 0)
            terms_[3] = dssim_.into(queue, p.high, seen.truth, weights.dssim, g.high);
    }
    /// Enqueues the terms of the three renders.
    template <class P>
    void render_terms(const CudaQueue& queue, const DeviceAvatarImages<P>& images,
                      const DeviceAvatarPictures& p, const DeviceAvatarCotangents& g) {
        clear(queue, g.final), clear(queue, g.face), clear(queue, g.eyes);
        terms_[1] = low_.into(
            queue, p.final, PictureTarget<P>{images.truth_small.pixels.data, images.visible_small},
            weights.low_resolution, g.final);
        const PictureTarget<P> small{images.truth_small.pixels.data, images.eyes_small};
        terms_[4] = eye_low_.into(queue, p.eyes, small, weights.eye_low, g.eyes);
        face_terms(queue, images, p, g);
    }
    /// Enqueues the term of the eyes' picture, if there is one.
    template <class P>
    void eyes_high_term(const CudaQueue& queue, const DeviceAvatarImages<P>& images,
                        const DeviceAvatarPictures& p, const DeviceAvatarCotangents& g) {
        clear(queue, g.eyes_high.pixels);
        if (!images.eyes_high) return;
        const PictureTarget<P> full{images.truth.pixels.data, images.eyes};
        terms_[5] = eye_high_.into(queue, p.eyes_high.pixels, full,
                                   weights.eye_high * weights.eye_high_every, g.eyes_high.pixels);
    }
    template <class P>
    void face_terms(const CudaQueue& queue, const DeviceAvatarImages<P>& images,
                    const DeviceAvatarPictures& p, const DeviceAvatarCotangents& g) {
        const BlankTarget<P> target{images.eyes_small, images.blank};
        terms_[6] = blank_.into(queue, p.face, target, weights.blank, g.face);
        if (weights.face_alone > 0) {
            const FaceAloneTarget<P> alone{images.truth_small.pixels.data,
                                           images.visible_small,
                                           images.eyes_small,
                                           images.mask_small,
                                           images.background,
                                           images.blank};
            terms_[7] = alone_.into(queue, p.face, alone, weights.face_alone, g.face);
        }
    }
    /// Returns truth and visibility of the picture after the random scale.
    template <class P>
    DeviceAvatarImages<P> moved(const CudaQueue& queue, const DeviceAvatarImages<P>& images) {
        DeviceAvatarImages<P> r = images;
        const Index pixels = images.truth.pixels.cols;
        moved_.reserve(queue, 4 * static_cast<std::size_t>(pixels) * sizeof(P) + 1);
        P* const truth = reinterpret_cast<P*>(moved_.data());
        P* const visible = truth + 3 * pixels;
        const int factor = images.truth.width / images.truth_small.width;
        resize_into(device_, queue,
                    ResizeKernel<P>{images.truth.pixels, images.scale, factor, truth});
        resize_into(device_, queue,
                    ResizeKernel<P>{{images.visible, 1, pixels}, images.scale, factor, visible});
        r.truth.pixels.data = truth;
        r.visible = visible;
        return r;
    }
    void clear(const CudaQueue& queue, const DeviceColumns<float>& g) {
        device_.fill(queue, g.data, 0, static_cast<std::size_t>(g.size()) * sizeof(float));
    }
    template <class P>
    static void check(const DeviceAvatarImages<P>& images, const DeviceAvatarPictures& p,
                      const DeviceAvatarCotangents& g) {
        const char* const who = "image losses";
        const auto &t = images.truth, &s = images.truth_small;
        require_picture(who, "truth", t, 3, t.width, t.height);
        require_picture(who, "small truth", s, 3, s.width, s.height);
        require_picture(who, "final picture", p.high, 3, t.width, t.height);
        require_picture(who, "its gradient", g.high, 3, t.width, t.height);
        if (images.eyes_high) {
            require_picture(who, "picture of the eyes", p.eyes_high, 3, t.width, t.height);
            require_picture(who, "its gradient", g.eyes_high, 3, t.width, t.height);
        }
        const auto render = [&](const char* what, Index cols) {
            require(cols == s.pixels.cols, who, what, " has ", cols, " pixels, expected ",
                    s.pixels.cols);
        };
        render("final render", p.final.cols);
        render("render of the face", p.face.cols);
        render("render of the eyes", p.eyes.cols);
        require(images.scale == nullptr ||
                    (s.width > 0 && s.height > 0 && t.width % s.width == 0 &&
                     t.height / s.height == t.width / s.width && t.height % s.height == 0),
                who, "truth of ", t.width, " x ", t.height, " is no multiple of the render's ",
                s.width, " x ", s.height, ", as a random scale needs");
    }

    Device device_;
    DeviceBranches<Device> branches_;
    Perceptual* perceptual_;
    DeviceDssim<Device> dssim_;
    DeviceRgbTerm<Device> high_, low_, eye_low_, eye_high_, blank_, alone_;
    DeviceBuffer<unsigned char> moved_;
    std::vector<DeviceLossTerm> terms_ = std::vector<DeviceLossTerm>(without_face);
    DeviceLossReport<Device> report_;
};

} // namespace rye
