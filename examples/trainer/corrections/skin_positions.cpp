// SPDX-License-Identifier: Apache-2.0
#include "corrections/skin_positions.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/Cholesky>

#include <rye/math/rotation.hpp>
#include <rye/train/capture_subject.hpp>

#include "data/threads.hpp"

namespace rye::trainer {
namespace {

constexpr double spread2 = 0.03 * 0.03; ///< variance of shine, in grey values

/// Chin, jaw, brows, nose and corners of the mouth, which determine a camera (iBUG numbering).
constexpr std::array<Index, 10> told{8, 2, 14, 17, 26, 21, 22, 30, 48, 54};

} // namespace

SkinPositions::SkinPositions(const Capture& capture, const std::vector<int>& frames,
                             const std::vector<std::size_t>& cameras,
                             const Vec3<double>& head, int largest)
    : pictures_(capture, frames, cameras, largest),
      middle_(capture.width / 2.0, capture.height / 2.0) {
    constexpr Index most_points = 2000;
    landmarks_.resize(3, static_cast<Index>(told.size() * frames.size()));
    for (std::size_t i = 0; i < frames.size(); ++i) {
        const CaptureFrame& f = capture.frames[static_cast<std::size_t>(frames[i])];
        const Index stride = 1 + f.vertices.cols() / most_points;
        const Columns<double> all = chosen_landmarks(f.landmarks, f.vertices, stride);
        const Vec3<double> centre = so3_exp(Vec3<double>(f.pose.head<3>())) * head * f.scale +
                                    f.pose.tail<3>();
        points_.push_back(all);
        outwards_.push_back((all.colwise() - centre).colwise().normalized());
        for (std::size_t l = 0; l < told.size(); ++l)
            landmarks_.col(static_cast<Index>(i * told.size() + l)) = f.landmarks.col(told[l]);
    }
}

std::vector<SkinPositions::Sample>
SkinPositions::samples(const std::vector<Pinhole<double>>& cameras) const {
    std::vector<std::size_t> first(1, 0);
    for (const Columns<double>& p : points_)
        first.push_back(first.back() + static_cast<std::size_t>(p.cols()));
    std::vector<std::vector<Sample>> of_frame(points_.size());
    program_threads().run(static_cast<Index>(points_.size()), [&](Index frame) {
        const auto i = static_cast<std::size_t>(frame);
        for (std::size_t k = 0; k < cameras.size(); ++k) {
            if (!pictures_.has(i, k)) continue;
            const Vec3<double> eye = cameras[k].centre();
            for (Index l = 0; l < points_[i].cols(); ++l) {
                const Vec3<double> x = points_[i].col(l);
                if (outwards_[i].col(l).dot((eye - x).normalized()) < frontal_skin) continue;
                if (const std::optional<SkinValue> v =
                        pictures_.value(i, k, cameras[k].project_point(x).head<2>()))
                    of_frame[i].push_back(
                        {k, first[i] + static_cast<std::size_t>(l), v->at, v->slope, v->grey});
            }
        }
    });
    std::vector<Sample> all;
    for (const std::vector<Sample>& s : of_frame) all.insert(all.end(), s.begin(), s.end());
    return all;
}

std::vector<double>
SkinPositions::differences(const std::vector<Pinhole<double>>& cameras) const {
    const std::vector<Sample> all = samples(cameras);
    std::size_t points = 0;
    for (const Columns<double>& p : points_) points += static_cast<std::size_t>(p.cols());
    std::vector<double> log_gain(cameras.size(), 0), out(cameras.size(), 0);
    constexpr int rounds = 4;
    for (int round = 0; round <= rounds; ++round) {
        std::vector<double> sum(points, 0), mine(all.size());
        std::vector<int> seen_by(points, 0);
        for (std::size_t i = 0; i < all.size(); ++i) {
            mine[i] = all[i].grey * std::exp(-log_gain[all[i].camera]);
            sum[all[i].point] += mine[i];
            ++seen_by[all[i].point];
        }
        std::vector<double> weights(cameras.size(), 0), costs = weights, normal = weights,
                            right = weights;
        for (std::size_t i = 0; i < all.size(); ++i) {
            const Sample& s = all[i];
            if (seen_by[s.point] < 3) continue;
            const double off = mine[i] - (sum[s.point] - mine[i]) / (seen_by[s.point] - 1);
            const double w = 1 / std::pow(1 + off * off / spread2, 2);
            normal[s.camera] += w * mine[i] * mine[i];
            right[s.camera] += w * off * mine[i];
            weights[s.camera] += 1;
            costs[s.camera] += off * off / (1 + off * off / spread2); // Geman and McClure's
        }
        for (std::size_t k = 0; k < cameras.size(); ++k) {
            if (weights[k] == 0) continue;
            out[k] = std::sqrt(costs[k] / weights[k]);
            log_gain[k] += right[k] / normal[k];
        }
    }
    return out;
}

std::vector<SeenPoint> SkinPositions::seen(const std::vector<Pinhole<double>>& cameras) const {
    const std::vector<Sample> all = samples(cameras);
    std::size_t points = 0;
    for (const Columns<double>& p : points_) points += static_cast<std::size_t>(p.cols());
    const auto count = static_cast<Index>(cameras.size());
    // Displacement, growth and turn of the picture, and the logarithm of a gain.
    Columns<double> moved = Columns<double>::Zero(5, count);
    VecX<double> used = VecX<double>::Zero(count);
    constexpr int rounds = 4;
    const auto place = [&](const Sample& s) { // about -1 to 1
        return Vec2<double>((s.at - middle_) / middle_.maxCoeff());
    };
    const auto displaced = [&](const Sample& s) {
        const auto k = static_cast<Index>(s.camera);
        const Vec2<double> x = place(s);
        return Vec2<double>(moved(0, k) + moved(2, k) * x.x() - moved(3, k) * x.y(),
                            moved(1, k) + moved(2, k) * x.y() + moved(3, k) * x.x());
    };
    for (int round = 0; round < rounds; ++round) {
        std::vector<double> sum(points, 0);
        std::vector<int> seen_by(points, 0);
        const auto now = [&](const Sample& s) {
            return (s.grey + s.slope.dot(displaced(s))) *
                   std::exp(-moved(4, static_cast<Index>(s.camera)));
        };
        for (const Sample& s : all) {
            sum[s.point] += now(s);
            ++seen_by[s.point];
        }
        std::vector<Mat<double, 5, 5>> normal(cameras.size(), Mat<double, 5, 5>::Zero());
        std::vector<Vec<double, 5>> right(cameras.size(), Vec<double, 5>::Zero());
        used.setZero();
        for (const Sample& s : all) {
            if (seen_by[s.point] < 3) continue;
            const double mine = now(s), others = (sum[s.point] - mine) / (seen_by[s.point] - 1);
            const double off = mine - others, w = 1 / std::pow(1 + off * off / spread2, 2);
            const double gain = std::exp(-moved(4, static_cast<Index>(s.camera)));
            const Vec2<double> x = place(s), g = gain * s.slope;
            Vec<double, 5> j;
            j << g.x(), g.y(), g.dot(x), g.y() * x.x() - g.x() * x.y(), -mine;
            normal[s.camera] += w * j * j.transpose();
            right[s.camera] -= w * off * j;
            used[static_cast<Index>(s.camera)] += 1;
        }
        for (Index k = 0; k < count; ++k) {
            auto& a = normal[static_cast<std::size_t>(k)];
            // A displacement of half a pixel of the compared pictures is expected, less of what
            // varies over the picture.
            const double pixel = 0.5 / pictures_.scale();
            a.diagonal().array() += spread2 / (pixel * pixel);
            right[static_cast<std::size_t>(k)].head<4>() -=
                spread2 / (pixel * pixel) * moved.col(k).head<4>();
            moved.col(k) += a.ldlt().solve(right[static_cast<std::size_t>(k)]);
        }
        moved.row(4).array() -= moved.row(4).mean();
    }
    std::vector<SeenPoint> out;
    constexpr double fewest = 500; // points, of all frames
    constexpr std::size_t fewest_frames = 6;
    // Their displacements are those of one similarity: together they tell as much as two points.
    const double sigma =
        0.15 * std::sqrt(static_cast<double>(landmarks_.cols()) / 2);
    for (std::size_t k = 0; k < cameras.size(); ++k) {
        std::size_t frames = 0;
        for (std::size_t i = 0; i < points_.size(); ++i)
            frames += pictures_.has(i, k) ? 1 : 0;
        if (used[static_cast<Index>(k)] < fewest || frames < fewest_frames) continue;
        for (Index l = 0; l < landmarks_.cols(); ++l) {
            Sample s{k, 0, cameras[k].project_point(Vec3<double>(landmarks_.col(l))).head<2>(),
                     Vec2<double>::Zero(), 0};
            if (!s.at.allFinite()) continue;
            out.push_back({static_cast<int>(k), static_cast<int>(l), s.at + displaced(s), sigma});
        }
    }
    return out;
}

} // namespace rye::trainer
