// SPDX-License-Identifier: Apache-2.0
/// rye/train/capture_samples.hpp: what a step of each stage is shown of a capture: drivers and
/// images of one frame, at the size of the render and of its super-resolution.
#pragma once

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include <rye/avatar/playable.hpp>
#include <rye/io/capture.hpp>
#include <rye/core/error.hpp>
#include <rye/train/capture_subject.hpp>
#include <rye/train/samples.hpp>

namespace rye {

/// Returns image + (1 - mask) * background; both at full size.
inline Image<float> on_background(const Image<float>& image, const Image<float>& mask,
                                  float background) {
    Image<float> out = image;
    out.pixels.rowwise() += background * (1.0f - mask.pixels.row(0).array()).matrix();
    return out;
}

/// Values of the columns and rows that extend an image.
enum class Border { repeated, zero };

/// Returns the image with columns on the right and rows below until `factor` divides both sides:
/// the last ones repeated, or zeros. Original pixels are unchanged.
inline Image<float> extended(const Image<float>& image, int factor,
                             Border border = Border::repeated) {
    require(factor > 0, "extended", "got the factor ", factor, ", expected > 0");
    const auto up = [factor](int side) { return (side + factor - 1) / factor * factor; };
    const int width = up(image.width), height = up(image.height);
    if (width == image.width && height == image.height) return image;
    Image<float> out(width, height, image.channels());
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x)
            if (border == Border::repeated || (x < image.width && y < image.height))
                out.at(x, y) =
                    image.at(std::min(x, image.width - 1), std::min(y, image.height - 1));
    return out;
}

/// Returns the averages of the extended image's factor x factor blocks.
inline Image<float> shrunk(const Image<float>& image, int factor,
                           Border border = Border::repeated) {
    if (factor == 1) return image;
    const Image<float> whole = extended(image, factor, border);
    Image<float> out(whole.width / factor, whole.height / factor, whole.channels());
    for (int y = 0; y < whole.height; ++y)
        for (int x = 0; x < whole.width; ++x) out.at(x / factor, y / factor) += whole.at(x, y);
    out.pixels /= static_cast<float>(factor * factor);
    return out;
}

/// One view of a capture.
struct FrameCamera {
    int frame, camera;  ///< indices of CaptureLabels::frames and camera_ids
};

/// Returns the mean position of the head in the training frames.
template <PictureReader P>
Vec3<double> mean_head(const CaptureOf<P>& capture) {
    Vec3<double> sum = Vec3<double>::Zero();
    for (const int f : capture.train)
        sum += capture.frames[static_cast<std::size_t>(f)].pose.template tail<3>();
    return sum / static_cast<double>(capture.train.size());
}

/// Returns the column of delta_view of a camera's pictures, about mean_head().
template <PictureReader P>
SeenBy<float> seen_by(const CaptureOf<P>& capture, int camera) {
    return {camera, mean_head(capture).template cast<float>()};
}

/// Returns unit vectors from mean_head() to each camera, 3 x cameras, the mean over training frames
/// that it shows; (0, 0, 1) for one that shows none.
template <PictureReader P>
Columns<double> view_directions(const CaptureOf<P>& capture) {
    const Vec3<double> head = mean_head(capture);
    Columns<double> all(3, capture.camera_count());
    for (int k = 0; k < capture.camera_count(); ++k) {
        Vec3<double> sum = Vec3<double>::Zero();
        for (const int f : capture.train)
            if (capture.view(f, k).present)
                sum += (capture.camera(f, k).centre() - head).normalized();
        all.col(k) = sum.norm() > 0.1 ? sum.normalized() : Vec3<double>::UnitZ();
    }
    return all;
}

/// Sizes of stage 2 that its images follow, and the axis of its gazes.
struct AvatarSampleShape {
    int doublings = 0;  ///< of the upsampler: the render is 2^doublings times smaller
    int channels = 3;   ///< of the render, for its background
    GazeAxis axis = GazeAxis::optical;
};

/// Returns images and drivers of one view for stage 2, on white.
template <PictureReader P>
AvatarSample<float> avatar_sample(const CaptureOf<P>& capture, const AvatarSampleShape& shape,
                                  const FrameCamera& view) {
    const auto [frame, camera] = view;
    const int factor = 1 << shape.doublings;
    AvatarSample<float> s;
    s.drivers = frame_drivers(capture, frame, shape.axis);
    const auto place = std::find(capture.train.begin(), capture.train.end(), frame);
    s.frame = place == capture.train.end() ? -1 : place - capture.train.begin();
    s.view = seen_by(capture, camera);
    s.camera = render_camera(capture.camera(frame, camera).template cast<float>(), factor);
    // Sides that the factor does not divide are extended by repetition; masks, extended by zeros,
    // exclude these pixels from comparisons.
    const Image<float> mask = extended(capture.mask(frame, camera), factor);
    s.truth = on_background(extended(capture.image(frame, camera), factor), mask, 1.0f);
    s.mask_small = shrunk(mask, factor).pixels;
    s.truth_small = shrunk(s.truth, factor);
    const Image<float> visible = extended(capture.visible(frame, camera), factor, Border::zero);
    s.visible = visible.pixels;
    s.visible_small = shrunk(visible, factor).pixels;
    const Image<float> eyes = extended(capture.eye_mask(frame, camera), factor, Border::zero);
    Image<float> both(eyes.width, eyes.height, 1);
    both.pixels = eyes.pixels.colwise().maxCoeff();
    s.eyes = both.pixels;
    s.eyes_small = shrunk(both, factor).pixels;
    s.background = VecX<float>::Ones(shape.channels);
    s.blank = s.background;
    return s;
}

namespace detail {

/// The part of a frame that a step of stage 1 is shown.
struct MeshSampleShape {
    int frame;                 ///< index of CaptureLabels::frames
    std::vector<int> cameras;  ///< indices of camera_ids
    int width = 256;           ///< of the rasterised image, about [px]
    GazeAxis axis = GazeAxis::optical;
};

} // namespace detail

/// Returns images and drivers of one frame for stage 1, over black.
template <PictureReader P>
MeshSample<float> mesh_sample(const CaptureOf<P>& capture, const CaptureSubject& subject,
                              const detail::MeshSampleShape& shape) {
    MeshSample<float> s;
    const int frame = shape.frame;
    s.drivers = frame_drivers(capture, frame, shape.axis);
    s.landmarks =
        to_canonical(capture.frame(frame), frame_landmarks(capture, frame)).template cast<float>();
    s.eye_displacement = eye_displacement(capture, subject, frame).template cast<float>();
    const int factor = std::max(1, capture.width / std::max(1, shape.width));
    for (const int camera : shape.cameras) {
        MeshView<float> v;
        v.camera = render_camera(capture.camera(frame, camera).template cast<float>(), factor);
        v.truth = shrunk(capture.image(frame, camera), factor);
        v.mask = shrunk(capture.mask(frame, camera), factor).pixels;
        v.visible = shrunk(capture.visible(frame, camera), factor, Border::zero).pixels;
        s.views.push_back(std::move(v));
    }
    return s;
}

} // namespace rye
