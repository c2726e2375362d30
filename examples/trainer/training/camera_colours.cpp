// SPDX-License-Identifier: Apache-2.0
#include "training/camera_colours.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include <rye/math/rotation.hpp>
#include <rye/math/srgb.hpp>

namespace rye::trainer {
namespace {

/// Colour that a camera sees at a point.
struct Sample {
    std::size_t camera, point;
    Vec3<double> colour; ///< logarithm of linear light
};

/// Returns the mean over the 3 x 3 pixels around a point; nothing at rims of the head and in dark
/// places.
std::optional<Vec3<double>> colour_at(const Image<float>& picture, const Image<float>& mask,
                                      const Vec3<double>& at) {
    constexpr double least = 0.01;
    if (!(at.x() >= 2 && at.y() >= 2 && at.x() < picture.width - 2 && at.y() < picture.height - 2))
        return std::nullopt;
    const int x = static_cast<int>(at.x()), y = static_cast<int>(at.y());
    Vec3<double> sum = Vec3<double>::Zero();
    for (int j = -1; j <= 1; ++j)
        for (int i = -1; i <= 1; ++i) {
            if (mask.at(x + i, y + j)[0] < 0.98F) return std::nullopt;
            for (Index c = 0; c < 3; ++c)
                sum[c] += linear_from_srgb(static_cast<double>(picture.at(x + i, y + j)[c])) / 9;
        }
    if (sum.minCoeff() < least) return std::nullopt;
    return Vec3<double>(sum.array().log());
}

/// Adds the colours that cameras see from the front at the landmarks of a frame.
void add_frame(const Capture& capture, int frame, const Vec3<double>& head_centre,
               std::vector<Sample>& all, std::size_t& points) {
    constexpr double frontal = 0.55; // cosine of the angle from outwards to the camera
    const CaptureFrame& f = capture.frames[static_cast<std::size_t>(frame)];
    const Columns<double> world = frame_landmarks(capture, frame), head = to_canonical(f, world);
    const Mat3<double> rotation = so3_exp(Vec3<double>(f.pose.head<3>()));
    std::vector<std::vector<Sample>> seen(static_cast<std::size_t>(world.cols()));
    for (int c = 0; c < capture.camera_count(); ++c) {
        if (!capture.view(frame, c).present) continue;
        const Image<float> picture = capture.image(frame, c), mask = capture.mask(frame, c);
        const Pinhole<double>& camera = capture.camera(frame, c);
        for (Index l = 0; l < world.cols(); ++l) {
            constexpr Index first_of_eyes = 36; // iBUG numbering; lips follow, to the last
            if (l >= first_of_eyes && l < f.landmarks.cols()) continue;
            const Vec3<double> out = rotation * (head.col(l) - head_centre).normalized();
            const Vec3<double> to_camera = (camera.centre() - world.col(l)).normalized();
            if (out.dot(to_camera) < frontal) continue;
            const auto colour =
                colour_at(picture, mask, camera.project_point(Vec3<double>(world.col(l))));
            if (colour)
                seen[static_cast<std::size_t>(l)].push_back(
                    {static_cast<std::size_t>(c), points + static_cast<std::size_t>(l), *colour});
        }
    }
    for (const std::vector<Sample>& of_point : seen)
        if (of_point.size() >= 2) all.insert(all.end(), of_point.begin(), of_point.end());
    points += seen.size();
}

/// Returns the logarithms of gains, 3 x cameras, of mean 0, by robust least squares alternating
/// between points and cameras.
Columns<double> log_gains(const std::vector<Sample>& all, std::size_t points, Index cameras) {
    constexpr int rounds = 60;
    constexpr double spread2 = 0.08 * 0.08; // variance of shine
    Columns<double> gain = Columns<double>::Zero(3, cameras);
    Columns<double> point = Columns<double>::Zero(3, static_cast<Index>(points));
    for (int round = 0; round < rounds; ++round) {
        const auto step = [&](Columns<double>& of, const Columns<double>& other, bool of_points) {
            Columns<double> sum = Columns<double>::Zero(3, of.cols()), weights = sum;
            for (const Sample& s : all) {
                const auto p = static_cast<Index>(s.point), c = static_cast<Index>(s.camera);
                const Index mine = of_points ? p : c, others = of_points ? c : p;
                for (Index k = 0; k < 3; ++k) {
                    const double rest = s.colour[k] - other(k, others), off = rest - of(k, mine);
                    const double w = round == 0 ? 1 : 1 / (1 + off * off / spread2);
                    sum(k, mine) += w * rest;
                    weights(k, mine) += w;
                }
            }
            of = (weights.array() > 0).select(sum.array() / weights.array().max(1e-12), of);
        };
        step(point, gain, true);
        step(gain, point, false);
        gain.colwise() -= gain.rowwise().mean().eval();
    }
    return gain;
}

} // namespace

LabelFinding correct_colours(Capture& capture, const TrainConfig& config) {
    LabelFinding found{"colours of cameras", 0, 3, "%", false,
                       "their gains are taken out of the pictures"};
    if (capture.camera_count() < 2) return found;
    constexpr std::size_t most_frames = 24;
    const Vec3<double> head_centre = describe_subject(capture, config).head_centre;
    std::vector<Sample> all;
    std::size_t points = 0;
    const std::size_t n = capture.train.size(), taken = std::min(n, most_frames);
    for (std::size_t i = 0; i < taken; ++i)
        add_frame(capture, capture.train[i * n / taken], head_centre, all, points);
    const Columns<double> gains = log_gains(all, points, capture.camera_count());
    found.off = 100 * std::sqrt(gains.squaredNorm() / static_cast<double>(gains.size()));
    found.wrong = found.off > found.bound;
    if (found.wrong)
        for (Index c = 0; c < gains.cols(); ++c)
            capture.camera_gains.push_back(gains.col(c).array().exp());
    return found;
}

} // namespace rye::trainer
