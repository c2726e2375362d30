// SPDX-License-Identifier: Apache-2.0
#include "importers/video_dots.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include <rye/core/error.hpp>
#include <rye/rig/gaze.hpp>

#include "data/degrees.hpp"
#include "data/median.hpp"
#include "importers/import_folder.hpp"

namespace rye::trainer {
namespace {

constexpr std::size_t fewest = 12; // pictures that show when the dots began
constexpr double least_correlation = 0.5;
/// Time after which the eyes rest on a dot: jumps take this long, and so do people differ [s].
constexpr double settled = 0.3;

double time_of(const Tracks& tracks, const VideoPose& pose) {
    return tracks.pictures[static_cast<std::size_t>(pose.picture)].time;
}
bool is_first(const Tracks& tracks, const VideoPose& pose) {
    return tracks.pictures[static_cast<std::size_t>(pose.picture)].video == 0;
}

/// Returns a dot's place in the world, whose axes are the camera's: x is to the person's left.
Vec3<double> place_of(const GazeDot& dot, const Pinhole<double>& camera) {
    constexpr double units_per_mm = 0.01;
    const Mat3<double> axes = Vec3<double>(1, -1, -1).asDiagonal(); // of the camera: y down, z forward
    const Vec3<double> in_camera =
        axes * (units_per_mm * Vec3<double>(-dot.right_up.x(), dot.right_up.y(), 0));
    return camera.centre() + camera.camera_from_world.rotation.transpose() * in_camera;
}

Vec3<double> between_eyes(const VideoHead& head, const VideoPose& pose) {
    return pose.world_from_head.apply(Vec3<double>(0.5 * (head.eyes[0].centre + head.eyes[1].centre)));
}

/// Returns the correlation of directions to the dots with the gazes, (pitch, yaw) in the world, if
/// the dots' clock begins at this time; nothing if too few pictures show a dot.
std::optional<double> correlation_at(double begin, const Tracks& tracks,
                                     const std::vector<GazeDot>& dots, const VideoHead& head) {
    std::array<std::vector<double>, 4> x; // pitch and yaw to the dot, then of the gaze
    for (const VideoPose& pose : head.poses) {
        if (!is_first(tracks, pose)) continue;
        const auto dot = dot_at(dots, time_of(tracks, pose) - begin, settled);
        if (!dot) continue;
        const Vec3<double> to = place_of(*dot, head.camera) - between_eyes(head, pose);
        // The axes of both eyes together have no kappa aside.
        const Vec3<double> looks = pose.world_from_head.rotation * (pose.gaze[0] + pose.gaze[1]);
        const Vec2<double> a = pitch_yaw(normalized(to)), b = pitch_yaw(normalized(looks));
        for (std::size_t k = 0; k < 2; ++k) {
            x[k].push_back(a[static_cast<Index>(k)]);
            x[2 + k].push_back(b[static_cast<Index>(k)]);
        }
    }
    const std::size_t n = x[0].size();
    if (n < fewest) return std::nullopt;
    for (std::vector<double>& all : x) {
        const double middle = median(all);
        for (double& one : all) one = std::clamp(one - middle, -0.6, 0.6);
    }
    double both = 0, dot = 0, gaze = 0;
    for (std::size_t k = 0; k < 2; ++k)
        for (std::size_t i = 0; i < n; ++i) {
            both += x[k][i] * x[2 + k][i];
            dot += x[k][i] * x[k][i];
            gaze += x[2 + k][i] * x[2 + k][i];
        }
    return dot > 0 && gaze > 0 ? both / std::sqrt(dot * gaze) : 0;
}

/// Line by which one angle follows from another in the least squares.
class Line {
  public:
    void add(double x, double y) {
        sum_ += Vec2<double>(x, y), products_ += Vec2<double>(x * x, x * y), ++count_;
    }
    double at(double x) const {
        const Vec2<double> mean = sum_ / count_;
        // Gazes that hardly differ tell no slope.
        constexpr double least = 2 * degree;
        const double variance = products_.x() / count_ - mean.x() * mean.x(),
                     both = products_.y() / count_ - mean.x() * mean.y();
        const double slope = variance > least * least ? std::clamp(both / variance, 0.0, 2.0) : 1;
        return mean.y() + slope * (x - mean.x());
    }

  private:
    Vec2<double> sum_ = Vec2<double>::Zero(), products_ = sum_;
    double count_ = 0;
};

/// Finds when the dots' clock began.
void find_begin(const Tracks& tracks, const std::vector<GazeDot>& dots, const VideoHead& head,
                const std::string& who, DotGazes& said) {
    double first = 1e9, last = -1e9;
    for (const VideoPose& pose : head.poses)
        if (is_first(tracks, pose)) {
            first = std::min(first, time_of(tracks, pose));
            last = std::max(last, time_of(tracks, pose));
        }
    constexpr double step = 0.02;
    std::vector<double> best; // times of the same pictures have the same correlation
    for (double begin = first - dots.back().end; begin <= last - dots.front().begin; begin += step) {
        const auto found = correlation_at(begin, tracks, dots, head);
        if (!found || *found < said.correlation) continue;
        if (*found > said.correlation) best.clear();
        said.correlation = *found;
        best.push_back(begin);
    }
    require(said.correlation >= least_correlation, who, "the gazes of the video follow these dots at "
            "no time (correlation ", [&] { return factor_text(said.correlation); }, ", expected ",
            least_correlation, " or more): the dots are of this video, and their screen is beside "
            "its camera?");
    said.begin = median(best);
}

} // namespace

DotGazes look_at_dots(const Tracks& tracks, const std::vector<GazeDot>& dots, const std::string& who,
                      VideoHead& head) {
    DotGazes said;
    find_begin(tracks, dots, head, who, said);
    std::array<std::array<Line, 2>, 2> by_own; // by eye, of pitch and yaw
    std::vector<bool> at_dot(head.poses.size(), false);
    double squares = 0;
    for (std::size_t i = 0; i < head.poses.size(); ++i) {
        VideoPose& pose = head.poses[i];
        if (!is_first(tracks, pose)) continue;
        const auto dot = dot_at(dots, time_of(tracks, pose) - said.begin, settled);
        if (!dot) continue;
        at_dot[i] = true;
        ++said.pictures;
        const Vec3<double> at = place_of(*dot, head.camera);
        for (std::size_t e = 0; e < 2; ++e) {
            const Vec3<double> to = at - pose.world_from_head.apply(head.eyes[e].centre);
            const Vec3<double> in_head = pose.world_from_head.rotation.transpose() * to;
            const Vec3<double> axis = usual_optical_axis(normalized(in_head), e);
            const Vec2<double> own = pitch_yaw(pose.gaze[e]), is = pitch_yaw(axis);
            for (std::size_t k = 0; k < 2; ++k)
                by_own[e][k].add(own[static_cast<Index>(k)], is[static_cast<Index>(k)]);
            squares += (is - own).squaredNorm();
            pose.gaze[e] = axis;
        }
    }
    said.off_deg = degrees * std::sqrt(squares / (4 * std::max(said.pictures, 1)));
    for (std::size_t i = 0; i < head.poses.size(); ++i) {
        if (at_dot[i]) continue;
        for (std::size_t e = 0; e < 2; ++e) {
            const Vec2<double> own = pitch_yaw(head.poses[i].gaze[e]);
            head.poses[i].gaze[e] = gaze_vector(by_own[e][0].at(own[0]), by_own[e][1].at(own[1]));
        }
    }
    return said;
}

} // namespace rye::trainer
