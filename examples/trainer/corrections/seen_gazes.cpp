// SPDX-License-Identifier: Apache-2.0
#include "corrections/seen_gazes.hpp"

#include <algorithm>
#include <cmath>

#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/degrees.hpp"
#include "data/threads.hpp"

namespace rye::trainer {
namespace {

/// Standard deviations of (pitch, yaw) of a sharp iris, and of the error that all views share. Lids
/// hide the upper and the lower rim, so yaw is more accurate. Measured on a path-traced capture.
const Vec2<double> of_a_view = degree * Vec2<double>(1.7, 0.8);
const Vec2<double> in_common = degree * Vec2<double>(0.9, 0.45);

/// Returns the median of an angle, weighted by sharpness.
double weighted_median(const std::vector<SeenIris>& all, Index angle) {
    std::vector<std::pair<double, double>> sorted;
    double sum = 0;
    for (const SeenIris& s : all) {
        const double weight = s.sharpness * s.sharpness;
        sorted.emplace_back(s.angles[angle], weight);
        sum += weight;
    }
    std::sort(sorted.begin(), sorted.end());
    double below = 0;
    for (const auto& [value, weight] : sorted)
        if ((below += weight) >= sum / 2) return value;
    return sorted.back().first;
}

/// Returns the mean of the irises, with less weight for those far from the median.
SeenGaze joined(const std::vector<SeenIris>& all) {
    SeenGaze gaze;
    if (all.empty()) return gaze;
    const Vec2<double> middle(weighted_median(all, 0), weighted_median(all, 1));
    constexpr double far = 4 * degree; // beyond it an iris counts less
    std::vector<double> weights;
    double sum = 0;
    for (const SeenIris& s : all) {
        const double off = (s.angles - middle).norm();
        weights.push_back(s.sharpness * s.sharpness * std::min(1.0, far / std::max(off, 1e-9)));
        sum += weights.back();
        gaze.angles += weights.back() * s.angles;
    }
    gaze.angles /= sum;
    gaze.views = static_cast<int>(all.size());
    for (Index k = 0; k < 2; ++k) {
        // A prior of three views, then the views.
        double squares = 3 * of_a_view[k] * of_a_view[k];
        for (std::size_t i = 0; i < all.size(); ++i)
            squares += weights[i] * std::pow(all[i].angles[k] - gaze.angles[k], 2);
        gaze.sigma[k] = std::hypot(std::sqrt(squares / (3 + sum) / sum), in_common[k]);
    }
    return gaze;
}

} // namespace

std::vector<std::array<std::vector<SeenIris>, 2>>
seen_irises(const Capture& capture, const std::vector<int>& frames,
            const std::vector<std::array<EyeballInHead, 2>>& balls, double area_error) {
    std::vector<std::array<std::vector<SeenIris>, 2>> all(frames.size());
    program_threads().run(static_cast<Index>(frames.size()), [&](Index k) {
        const auto i = static_cast<std::size_t>(k);
        const CaptureFrame& f = capture.frames[static_cast<std::size_t>(frames[i])];
        const Mat3<double> rotation = so3_exp(Vec3<double>(f.pose.head<3>()));
        std::array<std::vector<SeenIris>, 2>& seen = all[i];
        for (int c = 0; c < capture.camera_count(); ++c) {
            const CaptureView& view = capture.view(frames[i], c);
            if (!view.present || view.eye_mask.empty()) continue;
            const Image<float> eyes = capture.eye_mask(frames[i], c);
            std::array<int, 2> pixels{};
            for (std::size_t e = 0; e < 2; ++e)
                pixels[e] = usable_eye_pixels(
                    Columns<float>(eyes.pixels.row(static_cast<Index>(e))), eyes.width);
            if (std::max(pixels[0], pixels[1]) < min_eye_pixels) continue;
            const Image<float> picture = capture.image(frames[i], c);
            for (std::size_t e = 0; e < 2; ++e) {
                if (pixels[e] < min_eye_pixels) continue;
                const EyeballInHead& b = balls[i][e];
                const EyeballGeometry ball{
                    Vec3<double>(f.scale * (rotation * b.centre) + f.pose.tail<3>()),
                    f.scale * b.radius, f.scale * b.limbus_radius, rotation,
                    f.scale * b.iris_plane};
                const std::optional<GazeEstimate> found = estimate_gaze(
                    picture, Columns<float>(eyes.pixels.row(static_cast<Index>(e))), view.camera,
                    ball, area_error);
                if (!found) continue;
                constexpr double sharp = 100; // pixels
                const Vec3<double> iris =
                    ball.centre + ball.iris_plane * (rotation * found->gaze);
                const double edge = view.camera.fx * std::hypot(ball.iris_plane,
                                                                ball.limbus_radius);
                seen[e].push_back({c, pitch_yaw(found->gaze), std::min(1.0, found->pixels / sharp),
                                   view.camera.project_point(iris).head<2>(),
                                   edge / (ball.centre - view.camera.centre()).norm(),
                                   found->contrast});
            }
        }
    });
    return all;
}

std::vector<std::array<SeenGaze, 2>>
seen_gazes(const Capture& capture, const std::vector<int>& frames,
           const std::vector<std::array<EyeballInHead, 2>>& balls, double area_error) {
    std::vector<std::array<SeenGaze, 2>> all(frames.size());
    const std::vector<std::array<std::vector<SeenIris>, 2>> seen =
        seen_irises(capture, frames, balls, area_error);
    for (std::size_t i = 0; i < all.size(); ++i)
        for (std::size_t e = 0; e < 2; ++e) all[i][e] = joined(seen[i][e]);
    return all;
}

} // namespace rye::trainer
