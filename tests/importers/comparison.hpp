// SPDX-License-Identifier: Apache-2.0
/// tests/importers/comparison.hpp: differences of an imported capture from the true one. Worlds
/// may differ by a similarity, which the landmarks determine.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/capture.hpp"
#include "importers/face_geometry.hpp"
#include "synthetic_capture/scene.hpp"

namespace rye::trainer {

/// 4 frames, 3 cameras, 160 x 160 pixels.
inline CaptureSettings small_settings() {
    CaptureSettings s;
    s.size = 160;
    s.cameras = 3;
    s.train_frames = 3;
    s.novel_frames = 1;
    s.independent_frames = 0;
    return s;
}

/// Largest differences; frames and cameras are compared in their order.
struct Comparison {
    double gaze_deg = 0; ///< of optical axes in the world, after the similarity
    double mean_gaze_deg = 0;
    double landmarks = 0;       ///< true world units
    double centres = 0;         ///< of eyeballs
    double projection_px = 0;   ///< of the landmarks in the images, each by its own camera
    double mask_difference = 0; ///< mean over pixels, of 1
    double eye_overlap = 1;     ///< smallest intersection over union of an eye of 40 pixels or more
    double mean_overlap = 0;
    std::string text() const {
        return "gaze " + std::to_string(gaze_deg) + " (mean " + std::to_string(mean_gaze_deg) +
               ") deg, landmarks " + std::to_string(landmarks) + ", centres " +
               std::to_string(centres) + ", projection " + std::to_string(projection_px) +
               " px, mask " + std::to_string(mask_difference) + ", eyes " +
               std::to_string(eye_overlap) + " (mean " + std::to_string(mean_overlap) + ")";
    }
};

inline double overlap(const Image<float>& a, const Image<float>& b, Index eye, double& pixels) {
    double both = 0, either = 0;
    pixels = 0;
    for (Index i = 0; i < a.size(); ++i) {
        const bool x = a.pixels(eye, i) > 0, y = b.pixels(eye, i) > 0;
        both += x && y ? 1 : 0;
        either += x || y ? 1 : 0;
        pixels += x ? 1 : 0;
    }
    return either > 0 ? both / either : 1;
}

inline Comparison compare(const Capture& truth, const Capture& got) {
    Comparison c;
    int gazes = 0, eyes = 0;
    for (int f = 0; f < std::min(truth.frame_count(), got.frame_count()); ++f) {
        const CaptureFrame& a = truth.frames[static_cast<std::size_t>(f)];
        const CaptureFrame& b = got.frames[static_cast<std::size_t>(f)];
        const Vec3<double> mean_a = a.landmarks.rowwise().mean(),
                           mean_b = b.landmarks.rowwise().mean();
        const double size =
            (a.landmarks.colwise() - mean_a).norm() / (b.landmarks.colwise() - mean_b).norm();
        const Columns<double> sized = size * b.landmarks;
        const Rigid<double> to_truth = fit_rigid(sized, a.landmarks);
        const auto moved = [&](const Vec3<double>& x) {
            return Vec3<double>(to_truth.apply(Vec3<double>(size * x)));
        };
        for (Index i = 0; i < a.landmarks.cols(); ++i)
            c.landmarks = std::max(
                c.landmarks, (moved(b.landmarks.col(i)) - Vec3<double>(a.landmarks.col(i))).norm());
        for (std::size_t e = 0; e < 2; ++e) {
            const auto world = [&](const CaptureFrame& frame) {
                return Vec3<double>(so3_exp(Vec3<double>(frame.pose.head<3>())) *
                                    frame.eyes[e].optical);
            };
            const double off =
                57.29577951308232 * angular_error<double>(world(a), to_truth.rotation * world(b));
            c.gaze_deg = std::max(c.gaze_deg, off);
            c.mean_gaze_deg += off;
            ++gazes;
            if (a.eyes[e].centre && b.eyes[e].centre)
                c.centres =
                    std::max(c.centres, (moved(*b.eyes[e].centre) - *a.eyes[e].centre).norm());
        }
        for (int k = 0; k < std::min(truth.camera_count(), got.camera_count()); ++k) {
            if (!got.view(f, k).present) continue;
            for (Index i = 0; i < a.landmarks.cols(); ++i) {
                const Vec3<double> p = truth.camera(f, k).project_point(a.landmarks.col(i));
                const Vec3<double> q = got.camera(f, k).project_point(b.landmarks.col(i));
                c.projection_px = std::max(c.projection_px, (p - q).head<2>().norm());
            }
            const Image<float> m = truth.mask(f, k), n = got.mask(f, k);
            c.mask_difference = std::max(
                c.mask_difference, static_cast<double>((m.pixels - n.pixels).cwiseAbs().mean()));
            for (Index e = 0; e < 2; ++e) {
                double pixels = 0;
                const double share = overlap(truth.eye_mask(f, k), got.eye_mask(f, k), e, pixels);
                if (pixels < 40) continue;
                c.eye_overlap = std::min(c.eye_overlap, share);
                c.mean_overlap += share;
                ++eyes;
            }
        }
    }
    c.mean_gaze_deg /= std::max(gazes, 1);
    c.mean_overlap /= std::max(eyes, 1);
    return c;
}

} // namespace rye::trainer
