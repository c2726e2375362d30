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

/// Returns a dot's place before a camera with x right, y up and z back [dm].
Vec3<double> place_of(const GazeDot& dot) {
    constexpr double units_per_mm = 0.01;
    return units_per_mm * Vec3<double>(-dot.right_up.x(), dot.right_up.y(), 0);
}

/// The same in the world.
Vec3<double> place_of(const GazeDot& dot, const Pinhole<double>& camera) {
    const Mat3<double> axes = Vec3<double>(1, -1, -1).asDiagonal(); // of the camera: y down, z forward
    return camera.centre() +
           camera.camera_from_world.rotation.transpose() * Vec3<double>(axes * place_of(dot));
}

/// A picture of the first video: where its eyes look before the camera by the tracker alone, and where
/// they are.
struct TrackedLook {
    double time = 0;
    Vec3<double> eyes, gaze;
};

std::vector<TrackedLook> tracked_looks(const Tracks& tracks) {
    const Vec3<double> eyes_in_face(0, 0.3, 0.4); // middle of the eyeballs of the canonical face [dm]
    std::vector<TrackedLook> all;
    for (const TrackedPicture& p : tracks.pictures)
        if (p.video == 0 && p.faces == 1)
            all.push_back({p.time, p.head.apply(eyes_in_face),
                           p.head.turn(direction_of(tracked_look(tracks.names, p)))});
    return all;
}

/// Returns the correlation of directions to the dots with the gazes, (pitch, yaw) before the camera,
/// if the dots' clock begins at this time; nothing if too few pictures show a dot.
std::optional<double> correlation_at(double begin, const std::vector<TrackedLook>& looks,
                                     const std::vector<GazeDot>& dots) {
    std::array<std::vector<double>, 4> x; // pitch and yaw to the dot, then of the gaze
    for (const TrackedLook& look : looks) {
        const auto dot = dot_at(dots, look.time - begin, settled);
        if (!dot) continue;
        const Vec2<double> a = pitch_yaw(normalized(Vec3<double>(place_of(*dot) - look.eyes))),
                           b = pitch_yaw(look.gaze);
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

} // namespace

bool DotClock::has(const TrackedPicture& p) const {
    return p.video == 0 && p.time >= begin + dots.front().begin && p.time <= begin + dots.back().end;
}

std::optional<GazeDot> DotClock::looked_at(const TrackedPicture& p) const {
    return p.video == 0 ? dot_at(dots, p.time - begin, settled) : std::nullopt;
}

DotClock find_dots(const Tracks& tracks, std::vector<GazeDot> dots, const std::string& who) {
    DotClock said{std::move(dots)};
    const std::vector<TrackedLook> looks = tracked_looks(tracks);
    double first = 1e9, last = -1e9;
    for (const TrackedLook& look : looks) {
        first = std::min(first, look.time);
        last = std::max(last, look.time);
    }
    constexpr double step = 0.02;
    std::vector<double> best; // times of the same pictures have the same correlation
    for (double begin = first - said.dots.back().end; begin <= last - said.dots.front().begin;
         begin += step) {
        const auto found = correlation_at(begin, looks, said.dots);
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
    return said;
}

DotGazes look_at_dots(const Tracks& tracks, const DotClock& clock, VideoHead& head) {
    DotGazes said;
    std::array<std::array<Line, 2>, 2> by_own; // by eye, of pitch and yaw
    std::vector<bool> at_dot(head.poses.size(), false);
    double squares = 0;
    for (std::size_t i = 0; i < head.poses.size(); ++i) {
        VideoPose& pose = head.poses[i];
        const auto dot = clock.looked_at(tracks.pictures[static_cast<std::size_t>(pose.picture)]);
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
