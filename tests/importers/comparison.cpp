// SPDX-License-Identifier: Apache-2.0
#include "comparison.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>

#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "importers/face_geometry.hpp"

namespace rye::trainer {
namespace {

constexpr double degrees = 57.29577951308232, unit_mm = 100;

Mat3<double> rotation_of(const CaptureFrame& f) { return so3_exp(Vec3<double>(f.pose.head<3>())); }

Similarity fit_similarity(const Columns<double>& from, const Columns<double>& to) {
    const Vec3<double> a = from.rowwise().mean(), b = to.rowwise().mean();
    Similarity s;
    s.size = (to.colwise() - b).norm() / (from.colwise() - a).norm();
    s.motion = fit_rigid(s.size * from, to);
    return s;
}

double overlap(const Image<float>& a, const Image<float>& b, Index eye, double& pixels) {
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

/// Sums of differences over frames.
struct Sums {
    double gaze = 0, landmarks = 0, centres = 0, overlap = 0;
    int gazes = 0, points = 0, measured = 0, eyes = 0;
};

void compare_labels(const CaptureFrame& a, const CaptureFrame& b, const Similarity& same,
                    Comparison& c, Sums& sums) {
    for (Index i = 0; i < a.landmarks.cols(); ++i) {
        const Vec3<double> off = same(b.landmarks.col(i)) - Vec3<double>(a.landmarks.col(i));
        c.landmarks = std::max(c.landmarks, off.norm());
        sums.landmarks += off.squaredNorm() / 3;
        ++sums.points;
    }
    for (std::size_t e = 0; e < 2; ++e) {
        const double off = degrees * angular_error<double>(
                                         rotation_of(a) * a.eyes[e].optical,
                                         same.motion.rotation * rotation_of(b) * b.eyes[e].optical);
        c.gaze_deg = std::max(c.gaze_deg, off);
        sums.gaze += off;
        ++sums.gazes;
        if (!a.eyes[e].centre || !b.eyes[e].centre) continue;
        const double away = (same(*b.eyes[e].centre) - *a.eyes[e].centre).norm();
        c.centres = std::max(c.centres, away);
        sums.centres += away;
        ++sums.measured;
    }
}

void compare_pictures(const Capture& truth, const Capture& got, int f, Comparison& c, Sums& sums) {
    const auto& a = truth.frames[static_cast<std::size_t>(f)].landmarks;
    const auto& b = got.frames[static_cast<std::size_t>(f)].landmarks;
    for (int k = 0; k < std::min(truth.camera_count(), got.camera_count()); ++k) {
        if (!got.view(f, k).present) continue;
        for (Index i = 0; i < a.cols(); ++i) {
            const Vec3<double> p = truth.camera(f, k).project_point(a.col(i));
            const Vec3<double> q = got.camera(f, k).project_point(b.col(i));
            c.projection_px = std::max(c.projection_px, (p - q).head<2>().norm());
        }
        const Image<float> m = truth.mask(f, k), n = got.mask(f, k);
        c.mask_difference = std::max(c.mask_difference,
                                     static_cast<double>((m.pixels - n.pixels).cwiseAbs().mean()));
        for (Index e = 0; e < 2; ++e) {
            double pixels = 0;
            const double share = overlap(truth.eye_mask(f, k), got.eye_mask(f, k), e, pixels);
            if (pixels < 40) continue;
            c.eye_overlap = std::min(c.eye_overlap, share);
            sums.overlap += share;
            ++sums.eyes;
        }
    }
}

/// Returns the head's motion in an import, as seen from the true head.
Rigid<double> head_to_head(const CaptureFrame& a, const CaptureFrame& b, const Similarity& same) {
    const Mat3<double> back = rotation_of(a).transpose();
    return {back * same.motion.rotation * rotation_of(b),
            back * (same(b.pose.tail<3>()) - Vec3<double>(a.pose.tail<3>()))};
}

/// Adds the differences of the heads' motions from what all frames have in common.
void compare_poses(const std::vector<Rigid<double>>& all, Comparison& c) {
    Mat3<double> turns = Mat3<double>::Zero();
    Vec3<double> at = Vec3<double>::Zero();
    const auto count = static_cast<double>(all.size());
    for (const Rigid<double>& m : all) {
        turns += m.rotation;
        at += m.translation / count;
    }
    // The rotation nearest to their mean.
    Columns<double> from(3, 6), to(3, 6);
    from << Mat3<double>::Identity(), -Mat3<double>::Identity();
    to << turns, -turns;
    const Mat3<double> common = fit_rigid(from, to).rotation;
    for (const Rigid<double>& m : all) {
        c.pose_deg += so3_log(Mat3<double>(common.transpose() * m.rotation)).squaredNorm() / count;
        c.pose_mm += (m.translation - at).squaredNorm() / count;
    }
    c.pose_deg = degrees * std::sqrt(c.pose_deg);
    c.pose_mm = unit_mm * std::sqrt(c.pose_mm);
}

} // namespace

CaptureSettings small_settings() {
    CaptureSettings s;
    s.size = 160;
    s.cameras = 3;
    s.train_frames = 3;
    s.novel_frames = 1;
    s.independent_frames = 0;
    return s;
}

Similarity to_truth(const Capture& truth, const Capture& got, int frame) {
    const auto f = static_cast<std::size_t>(frame);
    std::vector<Vec3<double>> from, to;
    for (int k = 0; k < std::min(truth.camera_count(), got.camera_count()); ++k)
        if (truth.view(frame, k).present && got.view(frame, k).present) {
            from.push_back(got.camera(frame, k).centre());
            to.push_back(truth.camera(frame, k).centre());
        }
    // Landmarks, which may be wrong, decide what few cameras leave open.
    constexpr std::size_t enough = 3;
    const Columns<double>&a = got.frames[f].landmarks, &b = truth.frames[f].landmarks;
    if (from.size() < enough)
        for (Index i = 0; i < std::min(a.cols(), b.cols()); ++i) {
            from.push_back(a.col(i));
            to.push_back(b.col(i));
        }
    Columns<double> x(3, static_cast<Index>(from.size())), y = x;
    for (std::size_t i = 0; i < from.size(); ++i) {
        x.col(static_cast<Index>(i)) = from[i];
        y.col(static_cast<Index>(i)) = to[i];
    }
    return fit_similarity(x, y);
}

Comparison compare(const Capture& truth, const Capture& got, std::vector<int> frames) {
    if (frames.empty()) {
        frames.resize(static_cast<std::size_t>(std::min(truth.frame_count(), got.frame_count())));
        std::iota(frames.begin(), frames.end(), 0);
    }
    Comparison c;
    Sums sums;
    std::vector<Rigid<double>> heads;
    for (const int f : frames) {
        if (f >= got.frame_count()) continue;
        const CaptureFrame& a = truth.frames[static_cast<std::size_t>(f)];
        const CaptureFrame& b = got.frames[static_cast<std::size_t>(f)];
        const Similarity same = to_truth(truth, got, f);
        compare_labels(a, b, same, c, sums);
        compare_pictures(truth, got, f, c, sums);
        heads.push_back(head_to_head(a, b, same));
    }
    compare_poses(heads, c);
    c.mean_gaze_deg = sums.gaze / std::max(sums.gazes, 1);
    c.landmarks_mm = unit_mm * std::sqrt(sums.landmarks / std::max(sums.points, 1));
    c.mean_centres_mm = unit_mm * sums.centres / std::max(sums.measured, 1);
    c.mean_overlap = sums.overlap / std::max(sums.eyes, 1);
    return c;
}

std::string Comparison::text() const {
    char out[320];
    std::snprintf(out, sizeof out,
                  "gaze %.2f deg in the mean, %.2f at most; head %.2f deg, %.2f mm; landmarks %.2f "
                  "mm, %.2f at most; centres %.2f mm, %.2f at most; projection %.2f px; mask %.4f; "
                  "eyes %.2f of 1 in the mean, %.2f at least",
                  mean_gaze_deg, gaze_deg, pose_deg, pose_mm, landmarks_mm, unit_mm * landmarks,
                  mean_centres_mm, unit_mm * centres, projection_px, mask_difference, mean_overlap,
                  eye_overlap);
    return out;
}

} // namespace rye::trainer
