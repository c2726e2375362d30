// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/objective_cases.hpp: the image terms of stage 2's objective on a device against the
/// host's in double, for the emulated device and a real one.
#pragma once

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>
#include <rye/train/cuda/image_losses.hpp>

#include "../support/hostile.hpp"
#include "pictures.hpp"

namespace rye::test {

/// The parts of the objective that a case turns on.
struct ObjectiveCase {
    bool eyes_high = true, scale = false;
    double face_alone = 0, dssim = 0;
};

/// A picture of a random cloud with masks of bytes, and its pictures as the host makes them.
struct ObjectiveScene {
    static constexpr int width = 18, height = 14, factor = 2;
    AvatarImages<double> images;
    detail::Resizing resizing;
    TwoStreamGaussians<double> driven;
    Upsampler<double> upsampler;
    AvatarObjective<Exact64> objective;
    AvatarPictures<double> pictures;
    AvatarLosses<double> losses;

    explicit ObjectiveScene(const ObjectiveCase& c)
        : resizing(detail::random_resizing(width, height, Random{5})),
          upsampler(Upsampler<double>::init({5, 3, 1}, Random{6})) {
        const Scenery<double> scene = random_scene<double>(40, 5, 7, 0.3);
        driven.gaussians = scene.gaussians;
        driven.face_count = 25;
        AvatarImages<double>& s = images;
        s.camera = scene.camera;
        s.camera.width = width;
        s.camera.height = height;
        s.camera.cx = width / 2.0;
        s.camera.cy = height / 2.0;
        s.truth = in_double(byte_picture(factor * width, factor * height, 3, 1));
        s.truth_small = in_double(byte_picture(width, height, 3, 2));
        const Index small = s.truth_small.size(), full = s.truth.size();
        s.visible = Columns<double>::Ones(1, full);
        s.visible_small = Columns<double>::Ones(1, small);
        s.visible_small(0, 65) = 0;
        s.visible(0, 9) = 0;
        s.eyes = Columns<double>::Zero(1, full);
        s.eyes_small = Columns<double>::Zero(1, small);
        for (Index i = 60; i < 90; ++i) s.eyes_small(0, i) = i % 2 == 0 ? 1 : 0.4;
        for (Index i = 300; i < 400; ++i) s.eyes(0, i) = 1;
        s.mask_small = Columns<double>::Constant(1, small, 0.8);
        s.eyes_high = c.eyes_high;
        if (c.scale)
            s.scale = {detail::resized_map(resizing), detail::resized_map(resizing * factor)};
        s.background = VecX<double>::Ones(5);
        s.blank = VecX<double>::Constant(5, 0.25);
        AvatarLossConfig& w = objective.weights;
        w.face_alone = c.face_alone;
        w.dssim = c.dssim;
        w.eye_high_every = 3;
        losses = objective.value(ScalarBackend<Serial>{}, upsampler, images, driven, pictures);
    }
};

/// A mask of shares of 255 as a picture.
inline Image<float> mask_picture(const Columns<double>& mask) {
    Image<float> p(static_cast<int>(mask.cols()), 1, 1);
    p.pixels = mask.cast<float>();
    return p;
}

template <class Device>
void image_losses_against_host(const Device& device, const CudaQueue& queue,
                               const ObjectiveCase& c) {
    CAPTURE(c.scale);
    const ObjectiveScene scene(c);
    const AvatarImages<double>& s = scene.images;
    const AvatarPictures<double>& p = scene.pictures;
    const auto in_float = [](const Image<double>& from) {
        Image<float> r(from.width, from.height, from.channels());
        r.pixels = from.pixels.cast<float>();
        return r;
    };
    using Bytes = DeviceBytes<Device>;
    using Floats = DeviceFloats<Device>;
    const Bytes truth(device, queue, in_float(s.truth)),
        truth_small(device, queue, in_float(s.truth_small)),
        visible(device, queue, mask_picture(s.visible)),
        visible_small(device, queue, mask_picture(s.visible_small)),
        eyes(device, queue, mask_picture(s.eyes)),
        eyes_small(device, queue, mask_picture(s.eyes_small)),
        subject(device, queue, mask_picture(s.mask_small));
    const Floats final(device, queue, in_float(p.final.feature)),
        face(device, queue, in_float(p.face.feature)),
        of_eyes(device, queue, in_float(p.eyes.feature)), high(device, queue, in_float(p.high)),
        eyes_high(device, queue, in_float(p.eyes_high));
    const auto poisoned = [&](const Image<double>& like) {
        Image<float> r = in_float(like);
        r.pixels.setConstant(std::numeric_limits<float>::quiet_NaN());
        return Floats(device, queue, r);
    };
    const Floats g_final = poisoned(p.final.feature), g_face = poisoned(p.face.feature),
                 g_eyes = poisoned(p.eyes.feature), g_high = poisoned(p.high),
                 g_eyes_high = poisoned(p.eyes_high);
    const DeviceArray<Device> background(device, queue, Columns<float>::Constant(3, 1, 1.0F)),
        blank(device, queue, Columns<float>::Constant(3, 1, 0.25F));
    DeviceBuffer<detail::Resizing> resizing;
    resizing.reserve(queue, 1);
    device.send(queue, resizing.data(), &scene.resizing, sizeof scene.resizing);

    DeviceAvatarImages<std::uint8_t> images{truth.read(),          truth_small.read(),
                                            visible.buffer.data(), visible_small.buffer.data(),
                                            eyes.buffer.data(),    eyes_small.buffer.data(),
                                            subject.buffer.data()};
    images.eyes_high = c.eyes_high;
    images.scale = c.scale ? resizing.data() : nullptr;
    images.background = background.buffer.data();
    images.blank = blank.buffer.data();
    const DeviceAvatarPictures pictures{final.read().pixels, face.read().pixels,
                                        of_eyes.read().pixels, high.read(), eyes_high.read()};
    const DeviceAvatarCotangents g{g_final.view().pixels, g_face.view().pixels,
                                   g_eyes.view().pixels, g_high.view(), g_eyes_high.view()};
    DevicePyramidLoss<Device> pyramid(device);
    DeviceImageLosses<Device> losses(device, scene.objective.weights, pyramid);
    losses.into(queue, images, pictures, g);
    losses.report_into(queue);
    std::string bad = "?";
    const AvatarLosses<float> own = losses.fetch(queue, bad);
    CHECK(bad.empty());
    const AvatarLosses<double>& host = scene.losses;
    const auto same = [&](const char* name, float x, double y) {
        CAPTURE(name);
        CHECK(std::abs(static_cast<double>(x) - y) <= 1e-6 * std::abs(y));
    };
    same("high_resolution", own.high_resolution, host.high_resolution);
    same("low_resolution", own.low_resolution, host.low_resolution);
    same("perceptual", own.perceptual, host.perceptual);
    same("dssim", own.dssim, host.dssim);
    same("eye_low", own.eye_low, host.eye_low);
    same("eye_high", own.eye_high, host.eye_high);
    same("blank", own.blank, host.blank);
    same("face_alone", own.face_alone, host.face_alone);
    same("total", own.total, host.total);
    CHECK(host.blank > 0);
    CHECK((host.face_alone > 0) == (c.face_alone > 0));
    CHECK((host.eye_high > 0) == c.eyes_high);
    CHECK(relative(g_high.array.get(), p.g_high) <= 1e-6);
    CHECK(relative(g_eyes_high.array.get(), p.g_eyes_high) <= 1e-6);
    CHECK(relative(g_final.array.get(), p.g_final) <= 1e-6);
    CHECK(relative(g_face.array.get(), p.g_face) <= 1e-6);
    CHECK(relative(g_eyes.array.get(), p.g_eyes) <= 1e-6);
    // A second launch gives the same bits.
    const Columns<float> before = g_high.array.get();
    losses.into(queue, images, pictures, g);
    losses.report_into(queue);
    CHECK(losses.fetch(queue, bad).total == own.total);
    CHECK(g_high.array.get() == before);

    DeviceAvatarPictures wrong = pictures;
    wrong.face.cols -= 1;
    CHECK_FAULT(losses.into(queue, images, wrong, g),
                "render of the face has 251 pixels, expected 252");
}

/// The random scale of a picture and its vjp are the host's.
template <class Device>
void resizing_against_host(const Device& device, const CudaQueue& queue) {
    for (std::uint64_t seed = 0; seed < 6; ++seed) {
        const int w = 13, h = 11;
        const detail::Resizing r = detail::random_resizing(w, h, Random{seed});
        const std::vector<Index> map = detail::resized_map(r);
        const Image<float> source = float_picture(w, h, 4, seed);
        const DeviceFloats<Device> from(device, queue, source), to(device, queue, source),
            g(device, queue, source);
        DeviceBuffer<detail::Resizing> resizing;
        resizing.reserve(queue, 1);
        device.send(queue, resizing.data(), &r, sizeof r);
        resize_into(device, queue,
                    detail::ResizeKernel<float>{from.read().pixels, resizing.data(), 1,
                                                to.view().pixels.data});
        CHECK(to.array.get() == detail::gathered(source.pixels, map));
        resize_vjp_into(
            device, queue,
            detail::ResizeVjpKernel{from.read().pixels, resizing.data(), g.view().pixels.data});
        Columns<float> host = source.pixels;
        detail::gathered_vjp(source.pixels, map, host);
        CHECK(g.array.get() == host);
    }
}

} // namespace rye::test
