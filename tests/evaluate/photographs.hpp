// SPDX-License-Identifier: Apache-2.0
/// tests/evaluate/photographs.hpp: the gaze estimator on the photographs of a capture, against the
/// gaze of its labels.
#pragma once

#include <algorithm>
#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/capture.hpp"
#include "evaluation/evaluation.hpp"

namespace rye::test {

using trainer::Capture;
using trainer::EyesOfView;

/// One eye that counts, on one photograph.
struct PhotographedEye {
    std::size_t eye = 0;
    double outward = 0; ///< yaw of the camera, towards the temple of this eye [deg]
    double error = 0;   ///< of the estimate from the optical axis [deg], missed_degrees if missed
    double visual = 0;  ///< the same, turned by the eye's kappa, from the visual axis; NaN without
    bool found = false;
};

/// A photograph of another size: linear between pixels, or the mean of 4 x 4 samples if smaller.
inline Image<float> resized(const Image<float>& image, double scale) {
    if (scale == 1) return image;
    const int samples = scale < 1 ? 4 : 1;
    Image<float> out(static_cast<int>(image.width * scale), static_cast<int>(image.height * scale),
                     image.channels());
    const auto at = [&](double u, double v) {
        u = std::clamp(u - 0.5, 0.0, image.width - 1.001);
        v = std::clamp(v - 0.5, 0.0, image.height - 1.001);
        const int x = static_cast<int>(u), y = static_cast<int>(v);
        const auto a = static_cast<float>(u - x), b = static_cast<float>(v - y);
        return VecX<float>((1 - b) * ((1 - a) * image.at(x, y) + a * image.at(x + 1, y)) +
                           b * ((1 - a) * image.at(x, y + 1) + a * image.at(x + 1, y + 1)));
    };
    for (int y = 0; y < out.height; ++y)
        for (int x = 0; x < out.width; ++x) {
            for (int k = 0; k < samples * samples; ++k)
                out.at(x, y) += at((x + (k % samples + 0.5) / samples) / scale,
                                   (y + (k / samples + 0.5) / samples) / scale);
            out.at(x, y) /= static_cast<float>(samples * samples);
        }
    return out;
}

inline Pinhole<double> resized(Pinhole<double> camera, double scale) {
    camera.fx *= scale, camera.fy *= scale, camera.cx *= scale, camera.cy *= scale;
    camera.width = static_cast<int>(camera.width * scale);
    camera.height = static_cast<int>(camera.height * scale);
    return camera;
}

/// The capture's eyeballs and eye masks.
inline EyesOfView labelled_eyes(const Capture& capture, int frame, int camera) {
    const trainer::CaptureFrame& f = capture.frames[static_cast<std::size_t>(frame)];
    EyesOfView eyes;
    eyes.area = capture.eye_mask(frame, camera);
    for (std::size_t e = 0; e < 2; ++e) {
        const trainer::CaptureEye& label = f.eyes[e];
        eyes.ball[e] = {label.centre.value(), label.radius.value(), label.limbus_radius.value(),
                        so3_exp(Vec3<double>(f.pose.head<3>())), label.iris_plane.value_or(0)};
    }
    return eyes;
}

/// The same with areas that lie so many radii of the eyeball too high, as eyeballs of a run do
/// whose upper lids are too high.
inline EyesOfView raised_eyes(const Capture& capture, int frame, int camera, double radii) {
    EyesOfView eyes = labelled_eyes(capture, frame, camera);
    const Image<float> exact = eyes.area;
    const Pinhole<double>& view = capture.camera(frame, camera);
    const double depth = view.project_point(eyes.ball[0].centre).z();
    const int up = static_cast<int>(std::lround(radii * eyes.ball[0].radius * view.fy / depth));
    eyes.area.pixels.setZero();
    for (int y = 0; y + up < exact.height; ++y)
        for (int x = 0; x < exact.width; ++x) eyes.area.at(x, y) = exact.at(x, y + up);
    eyes.area_error = trainer::own_area_error;
    return eyes;
}

/// How the estimator is told where the eyes of a view are.
using EyesOf = std::function<EyesOfView(int frame, int camera)>;

/// Each eye that the capture's eye masks show min_eye_pixels of, at this size of the photographs.
inline std::vector<PhotographedEye> gaze_of_photographs(const Capture& capture,
                                                        const std::vector<int>& frames,
                                                        double scale, const EyesOf& eyes_of) {
    constexpr double degrees = 180 / 3.14159265358979323846;
    std::vector<PhotographedEye> all;
    for (const int f : frames)
        for (int c = 0; c < capture.camera_count(); ++c) {
            if (!capture.view(f, c).present) continue;
            Image<float> image = capture.image(f, c);
            image.pixels.rowwise() +=
                Eigen::RowVectorXf((1 - capture.mask(f, c).pixels.row(0).array()).matrix());
            image = resized(image, scale);
            const Pinhole<double> view = resized(capture.camera(f, c), scale);
            const Image<float> exact = resized(capture.eye_mask(f, c), scale);
            const EyesOfView given = eyes_of(f, c);
            const Image<float> area = resized(given.area, scale);
            for (std::size_t e = 0; e < 2; ++e) {
                const auto row = static_cast<Index>(e);
                const Columns<float> visible = exact.pixels.row(row);
                if (trainer::usable_eye_pixels(visible, exact.width) < trainer::min_eye_pixels)
                    continue;
                const trainer::CaptureEye& label =
                    capture.frames[static_cast<std::size_t>(f)].eyes[e];
                const Vec3<double> from = view.centre() - given.ball[e].centre;
                PhotographedEye eye{e, degrees * std::atan2(from.x(), from.z()) * (e == 0 ? 1 : -1),
                                    trainer::missed_degrees,
                                    label.visual ? trainer::missed_degrees : std::nan(""), false};
                if (const auto found = trainer::estimate_gaze(image, area.pixels.row(row), view,
                                                              given.ball[e], given.area_error)) {
                    eye.found = true;
                    eye.error = degrees * angular_error(found->gaze, label.optical);
                    if (label.visual) {
                        const Vec2<double> kappa =
                            pitch_yaw(label.optical) - pitch_yaw(*label.visual);
                        const Vec2<double> looks = pitch_yaw(found->gaze) - kappa;
                        eye.visual =
                            degrees * angular_error(gaze_vector(looks[0], looks[1]), *label.visual);
                    }
                }
                all.push_back(eye);
            }
        }
    return all;
}

struct GazeSummary {
    int eyes = 0, missed = 0;
    double mean = 0, median = 0, tenth = 0; ///< of the error [deg]; a tenth of the eyes has more
    double visual = 0;                      ///< mean error from the visual axis [deg]
};

inline GazeSummary summary(const std::vector<PhotographedEye>& all) {
    GazeSummary s;
    std::vector<double> errors;
    for (const PhotographedEye& e : all) {
        ++s.eyes, s.missed += e.found ? 0 : 1;
        s.mean += e.error, s.visual += e.visual;
        errors.push_back(e.error);
    }
    if (errors.empty()) return s;
    std::sort(errors.begin(), errors.end());
    s.mean /= s.eyes, s.visual /= s.eyes;
    s.median = errors[errors.size() / 2];
    s.tenth = errors[errors.size() * 9 / 10];
    return s;
}

} // namespace rye::test
