// SPDX-License-Identifier: Apache-2.0
#include "data/samples.hpp"

#include <algorithm>
#include <cmath>

#include <rye/avatar/playable.hpp>
#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>

namespace rye::trainer {
namespace {

Mat3<double> head_rotation(const CaptureFrame& frame) {
    return so3_exp(Vec3<double>(frame.pose.head<3>()));
}

Vec3<double> eye_landmark_centre(const Columns<double>& landmarks, int eye) {
    Vec3<double> sum = Vec3<double>::Zero();
    for (const int k : eye_landmarks(eye)) sum += landmarks.col(k);
    return sum / 6.0;
}

/// Returns the stride of the vertices that are dense landmarks.
Index vertex_stride(const Columns<double>& vertices) {
    return std::max<Index>(1, vertices.cols() / dense_landmarks);
}

int rounded_up(int size, int factor) {
    require(
        factor > 0, "rounded_up", "got the factor ", [&] { return std::to_string(factor); },
        ", expected > 0");
    return (size + factor - 1) / factor * factor;
}

} // namespace

Columns<double> chosen_landmarks(const Columns<double>& landmarks,
                                 const Columns<double>& vertices) {
    const Index stride = vertex_stride(vertices);
    const Index dense = vertices.cols() == 0 ? 0 : (vertices.cols() - 1) / stride + 1;
    Columns<double> all(3, landmarks.cols() + dense);
    all.leftCols(landmarks.cols()) = landmarks;
    for (Index k = 0; k < dense; ++k) all.col(landmarks.cols() + k) = vertices.col(k * stride);
    return all;
}

Columns<double> frame_landmarks(const Capture& capture, int frame) {
    const CaptureFrame& f = capture.frames[static_cast<std::size_t>(frame)];
    return chosen_landmarks(f.landmarks, f.vertices);
}

void set_frame_landmarks(CaptureFrame& frame, const Columns<double>& landmarks) {
    const Index sparse = frame.landmarks.cols(), stride = vertex_stride(frame.vertices);
    frame.landmarks = landmarks.leftCols(sparse);
    for (Index k = sparse; k < landmarks.cols(); ++k)
        frame.vertices.col((k - sparse) * stride) = landmarks.col(k);
}

Columns<double> to_canonical(const CaptureFrame& frame, const Columns<double>& world) {
    const Vec3<double> t = frame.pose.tail<3>();
    return head_rotation(frame).transpose() * (world.colwise() - t) / frame.scale;
}

Subject describe_subject(const Capture& capture, const TrainConfig& config) {
    const std::string who = capture.folder.string();
    require(!capture.train.empty(), who, "the capture has no training frames");
    require(capture.has_gaze(), who,
            "a frame has no params/<frame>/gaze.npz; training needs the gaze of every frame");
    const CaptureFrame& first = capture.frames[static_cast<std::size_t>(capture.train.front())];
    Subject s;
    s.neutral = to_canonical(first, frame_landmarks(capture, capture.train.front()));
    const Index sparse = first.landmarks.cols();
    for (Index k = 0; k < s.neutral.cols(); ++k)
        if (k < 36 || k >= 48) s.roles.expression.push_back(k);  // P_0: all except the eyes
    for (int eye = 0; eye < 2; ++eye)
        for (const int k : eye_landmarks(eye)) s.roles.eye[static_cast<std::size_t>(eye)].push_back(k);

    // Estimated middle of the head: 0.7 face widths behind the tip of the nose and a fifth of one
    // above the middle of the face.
    const Vec3<double> lo = s.neutral.leftCols(sparse).rowwise().minCoeff();
    const Vec3<double> hi = s.neutral.leftCols(sparse).rowwise().maxCoeff();
    const double width = hi.x() - lo.x();
    s.head_centre = Vec3<double>((lo.x() + hi.x()) / 2, (lo.y() + hi.y()) / 2 + 0.2 * width,
                                 hi.z() - 0.7 * width);

    s.measured_eyes = config.measured_eyes && capture.has_centres();
    for (int eye = 0; eye < 2; ++eye) {
        const std::size_t e = static_cast<std::size_t>(eye);
        const CaptureEye& from = first.eyes[e];
        const EyeSizes sizes = eye_sizes(s.measured_eyes ? from : CaptureEye{}, first.scale,
                                         config.gaussians.eyeball.radius);
        require_eyeball(sizes, who + ": frame '" + first.id + "': the " +
                                   (eye == 0 ? "left" : "right") + " eyeball");
        s.eye_radius[e] = sizes.radius;
        s.limbus_radius[e] = sizes.limbus_radius;
        s.iris_plane[e] = sizes.iris_plane;
        if (s.measured_eyes) {
            s.eye_centre[e] = to_canonical(first, *from.centre);
        } else {
            // The lids touch the front of the sphere, so its centre is behind their mean.
            s.eye_centre[e] = eye_landmark_centre(s.neutral, eye);
            s.eye_centre[e].z() -= 0.9 * s.eye_radius[e];
        }
    }
    return s;
}

Vec3<double> gaze_of(const CaptureEye& eye, GazeAxis axis) {
    return axis == GazeAxis::visual ? eye.visual.value() : eye.optical;
}

void require_gazes(const Capture& capture, GazeAxis axis) {
    if (axis == GazeAxis::optical) return;
    for (const CaptureFrame& f : capture.frames)
        for (std::size_t e = 0; e < 2; ++e)
            require(f.has_gaze && f.eyes[e].visual, capture.folder.string(), "frame '", f.id,
                    "': gaze.npz has no visual_", (e == 0 ? "left" : "right"),
                    ", expected it in every frame, since the run's gaze_axis is 'visual'");
}

Drivers<float> frame_drivers(const Capture& capture, int frame, GazeAxis axis) {
    const CaptureFrame& f = capture.frames[static_cast<std::size_t>(frame)];
    Drivers<float> d;
    d.expression = Eigen::Map<const VecX<float>>(f.expression.data(),
                                                 static_cast<Index>(f.expression.size()));
    d.pose = f.pose.cast<float>();
    d.scale = static_cast<float>(f.scale);
    for (std::size_t eye = 0; eye < 2; ++eye)
        d.gaze[eye] = gaze_of(f.eyes[eye], axis).cast<float>();
    return d;
}

Columns<double> eye_displacement(const Capture& capture, const Subject& subject, int frame) {
    const CaptureFrame& f = capture.frames[static_cast<std::size_t>(frame)];
    Columns<double> d(3, 2);
    for (int eye = 0; eye < 2; ++eye) {
        if (subject.measured_eyes) {
            const Columns<double> now =
                to_canonical(f, *f.eyes[static_cast<std::size_t>(eye)].centre);
            d.col(eye) = now - subject.eye_centre[static_cast<std::size_t>(eye)];
        } else {
            const Columns<double> now = to_canonical(f, f.landmarks);
            d.col(eye) = eye_landmark_centre(now, eye) - eye_landmark_centre(subject.neutral, eye);
        }
    }
    return d;
}

Image<float> on_background(const Image<float>& image, const Image<float>& mask, float background) {
    Image<float> out = image;
    out.pixels.rowwise() += background * (1.0f - mask.pixels.row(0).array()).matrix();
    return out;
}

Image<float> extended(const Image<float>& image, int factor, Border border) {
    const int width = rounded_up(image.width, factor), height = rounded_up(image.height, factor);
    if (width == image.width && height == image.height) return image;
    Image<float> out(width, height, image.channels());
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x)
            if (border == Border::repeated || (x < image.width && y < image.height))
                out.at(x, y) = image.at(std::min(x, image.width - 1), std::min(y, image.height - 1));
    return out;
}

Image<float> shrunk(const Image<float>& image, int factor, Border border) {
    if (factor == 1) return image;
    const Image<float> whole = extended(image, factor, border);
    Image<float> out(whole.width / factor, whole.height / factor, whole.channels());
    for (int y = 0; y < whole.height; ++y)
        for (int x = 0; x < whole.width; ++x) out.at(x / factor, y / factor) += whole.at(x, y);
    out.pixels /= static_cast<float>(factor * factor);
    return out;
}

Pinhole<float> reduced(const Pinhole<float>& camera, int factor) {
    return render_camera(camera, factor);
}

AvatarSample<float> avatar_sample(const Capture& capture, const TrainConfig& config, int frame,
                                  int camera) {
    const int factor = 1 << config.gaussians.upsampler.doublings;
    AvatarSample<float> s;
    s.drivers = frame_drivers(capture, frame, config.gaze_axis);
    const auto place = std::find(capture.train.begin(), capture.train.end(), frame);
    s.frame = place == capture.train.end() ? -1 : place - capture.train.begin();
    s.camera = reduced(capture.camera(frame, camera).cast<float>(), factor);
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
    s.background = VecX<float>::Ones(config.avatar.channels);
    s.blank = s.background;
    return s;
}

MeshSample<float> mesh_sample(const Capture& capture, const Subject& subject,
                              const TrainConfig& config, int frame,
                              const std::vector<int>& cameras) {
    const CaptureFrame& f = capture.frames[static_cast<std::size_t>(frame)];
    MeshSample<float> s;
    s.drivers = frame_drivers(capture, frame, config.gaze_axis);
    s.landmarks = to_canonical(f, frame_landmarks(capture, frame)).cast<float>();
    s.eye_displacement = eye_displacement(capture, subject, frame).cast<float>();
    for (const int camera : cameras) {
        const int factor = std::max(1, capture.width / std::max(1, config.mesh.image_size));
        MeshView<float> v;
        v.camera = reduced(capture.camera(frame, camera).cast<float>(), factor);
        v.truth = shrunk(capture.image(frame, camera), factor);
        v.mask = shrunk(capture.mask(frame, camera), factor).pixels;
        v.visible = shrunk(capture.visible(frame, camera), factor, Border::zero).pixels;
        s.views.push_back(std::move(v));
    }
    return s;
}

} // namespace rye::trainer
