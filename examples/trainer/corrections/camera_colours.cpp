// SPDX-License-Identifier: Apache-2.0
#include "corrections/camera_colours.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include <Eigen/Cholesky>

#include <rye/math/rotation.hpp>
#include <rye/math/srgb.hpp>

#include "data/threads.hpp"

namespace rye::trainer {
namespace {

constexpr int most_exposures = 1200; // frames whose exposures are judged

/// Colour that a camera sees at a point.
struct Sample {
    std::size_t camera, point;
    Vec3<double> colour; ///< logarithm of linear light
};

/// Colour that a camera sees at a landmark.
struct SeenColour {
    int camera;
    std::size_t landmark;
    Vec3<double> colour; ///< logarithm of linear light
    Vec3<double> out;    ///< from the head outwards, about the normal, world
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

/// Returns the colours that every stride-th camera sees from the front at the landmarks of a frame.
std::vector<SeenColour> colours_of(const Capture& capture, int frame,
                                   const Vec3<double>& head_centre, int stride = 1) {
    constexpr double frontal = 0.55; // cosine of the angle from outwards to the camera
    const CaptureFrame& f = capture.frames[static_cast<std::size_t>(frame)];
    const Columns<double> world = frame_landmarks(capture, frame), head = to_canonical(f, world);
    const Mat3<double> rotation = so3_exp(Vec3<double>(f.pose.head<3>()));
    std::vector<SeenColour> seen;
    for (int c = 0; c < capture.camera_count(); c += stride) {
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
            if (colour) seen.push_back({c, static_cast<std::size_t>(l), *colour, out});
        }
    }
    return seen;
}

/// Adds what two cameras or more see in a frame; its points follow those of other frames.
void add_frame(const std::vector<SeenColour>& seen, std::size_t landmarks, std::size_t points,
               std::vector<Sample>& all) {
    std::vector<std::vector<Sample>> of(landmarks);
    for (const SeenColour& s : seen)
        of[s.landmark].push_back(
            {static_cast<std::size_t>(s.camera), points + s.landmark, s.colour});
    for (const std::vector<Sample>& l : of)
        if (l.size() >= 2) all.insert(all.end(), l.begin(), l.end());
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

/// Returns the root mean square of logarithms [percent].
double percent(const Eigen::Ref<const Eigen::MatrixXd>& logs) {
    return logs.size() == 0
               ? 0
               : 100 * std::sqrt(logs.squaredNorm() / static_cast<double>(logs.size()));
}

LabelFinding correct_cameras_colours(Capture& capture, const Vec3<double>& head_centre) {
    LabelFinding found{"colours of cameras", 0, 3, "%", false,
                       "their gains are taken out of the pictures"};
    if (capture.camera_count() < 2) return found;
    constexpr std::size_t most_frames = 24;
    std::vector<Sample> all;
    std::size_t points = 0;
    const std::size_t n = capture.train.size(), taken = std::min(n, most_frames);
    std::vector<std::vector<SeenColour>> seen(taken);
    const auto frame_of = [&](std::size_t i) { return capture.train[i * n / taken]; };
    program_threads().run(static_cast<Index>(taken), [&](Index i) {
        const auto k = static_cast<std::size_t>(i);
        seen[k] = colours_of(capture, frame_of(k), head_centre);
    });
    for (std::size_t i = 0; i < taken; ++i) {
        const auto landmarks =
            static_cast<std::size_t>(frame_landmarks(capture, frame_of(i)).cols());
        add_frame(seen[i], landmarks, points, all);
        points += landmarks;
    }
    const Columns<double> gains = log_gains(all, points, capture.camera_count());
    found.off = percent(gains);
    found.wrong = found.off > found.bound;
    if (found.wrong)
        for (Index c = 0; c < gains.cols(); ++c)
            capture.camera_gains.push_back(gains.col(c).array().exp());
    return found;
}

/// Brightness of a landmark in a camera and a frame, by skin, exposure and the light on it.
struct Lit {
    std::size_t frame, point;
    double brightness; ///< logarithm of linear light, mean of the channels
    Vec<double, 8> light;
};
/// Returns functions of a normal in which a diffuse surface's light is nearly linear, without the
/// constant: harmonics of degrees 1 and 2 (Ramamoorthi and Hanrahan, 2001).
Vec<double, 8> light_functions(const Vec3<double>& n) {
    Vec<double, 8> f;
    f << n.x(), n.y(), n.z(), n.x() * n.y(), n.y() * n.z(), n.x() * n.z(),
        n.x() * n.x() - n.y() * n.y(), 3 * n.z() * n.z() - 1;
    return f;
}

/// Returns the logarithms of exposures, of mean 0, by robust least squares alternating between
/// points, exposures, and lights that stay where they are while the head turns.
VecX<double> log_exposures(const std::vector<Lit>& all, std::size_t points, Index frames) {
    constexpr int rounds = 100;
    constexpr double spread2 = 0.05 * 0.05; // variance of shine
    VecX<double> point = VecX<double>::Zero(static_cast<Index>(points));
    VecX<double> exposure = VecX<double>::Zero(frames);
    Vec<double, 8> light = Vec<double, 8>::Zero();
    for (int round = 0; round < rounds; ++round) {
        VecX<double> point_sum = VecX<double>::Zero(point.size()), point_weight = point_sum;
        for (const Lit& s : all) {
            const auto p = static_cast<Index>(s.point), f = static_cast<Index>(s.frame);
            const double rest = s.brightness - exposure[f] - light.dot(s.light);
            const double off = rest - point[p];
            const double w = round == 0 ? 1 : 1 / (1 + off * off / spread2);
            point_sum[p] += w * rest;
            point_weight[p] += w;
        }
        point = (point_weight.array() > 0)
                    .select(point_sum.array() / point_weight.array().max(1e-12), point);
        // Exposures and lights at once.
        const Index n = frames + 8;
        Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(8, 8);
        Eigen::MatrixXd both = Eigen::MatrixXd::Zero(frames, 8);
        VecX<double> weight = VecX<double>::Constant(frames, 1e-9), right = VecX<double>::Zero(n);
        normal.diagonal().setConstant(1e-9);
        for (const Lit& s : all) {
            const auto p = static_cast<Index>(s.point), f = static_cast<Index>(s.frame);
            const double rest = s.brightness - point[p];
            const double off = rest - exposure[f] - light.dot(s.light);
            const double w = round == 0 ? 1 : 1 / (1 + off * off / spread2);
            weight[f] += w;
            right[f] += w * rest;
            right.tail(8) += w * rest * s.light;
            both.row(f) += w * s.light.transpose();
            normal += w * s.light * s.light.transpose();
        }
        const Eigen::MatrixXd per_frame = weight.cwiseInverse().asDiagonal() * both;
        light = (normal - both.transpose() * per_frame)
                    .ldlt()
                    .solve(right.tail(8) - per_frame.transpose() * right.head(frames));
        exposure = right.head(frames).cwiseQuotient(weight) - per_frame * light;
        exposure.array() -= exposure.mean();
    }
    return exposure;
}

LabelFinding correct_exposures(Capture& capture, const Vec3<double>& head_centre) {
    LabelFinding found{"exposures of frames", 0, 8, "%", false,
                       "they are taken out of the pictures"};
    // Four cameras, or fewer so that about as many pictures are read of many frames.
    const int most_cameras =
        std::clamp(most_exposures / std::max(capture.frame_count(), 1), 1, 4);
    const int stride = 1 + (capture.camera_count() - 1) / most_cameras;
    std::vector<Lit> all;
    // The same landmark in another camera is another point: its shine differs.
    const auto cameras = static_cast<std::size_t>(capture.camera_count());
    std::size_t points = 0;
    std::vector<std::vector<SeenColour>> seen(static_cast<std::size_t>(capture.frame_count()));
    program_threads().run(capture.frame_count(), [&](Index f) {
        seen[static_cast<std::size_t>(f)] =
            colours_of(capture, static_cast<int>(f), head_centre, stride);
    });
    for (std::size_t f = 0; f < seen.size(); ++f)
        for (const SeenColour& s : seen[f]) {
            const std::size_t point = s.landmark * cameras + static_cast<std::size_t>(s.camera);
            all.push_back({f, point, s.colour.mean(),
                           light_functions(s.out)});
            points = std::max(points, point + 1);
        }
    const VecX<double> of = log_exposures(all, points, capture.frame_count());
    found.off = percent(of);
    found.wrong = found.off > found.bound;
    if (found.wrong)
        for (Index f = 0; f < of.size(); ++f) capture.frame_exposures.push_back(std::exp(of[f]));
    return found;
}

} // namespace

std::vector<LabelFinding> correct_colours(Capture& capture, const TrainConfig& config) {
    const Vec3<double> head_centre = describe_subject(capture, config).head_centre;
    std::vector<LabelFinding> found;
    found.push_back(correct_cameras_colours(capture, head_centre));
    if (capture.frame_count() <= most_exposures)
        found.push_back(correct_exposures(capture, head_centre));
    return found;
}

} // namespace rye::trainer
