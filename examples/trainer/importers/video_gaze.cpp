// SPDX-License-Identifier: Apache-2.0
#include "importers/video_gaze.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include <rye/core/error.hpp>
#include <rye/rig/gaze.hpp>

#include "corrections/gaze_estimator.hpp"
#include "data/degrees.hpp"
#include "data/median.hpp"
#include "data/picture.hpp"
#include "data/threads.hpp"
#include "importers/face_mesh.hpp"

namespace rye::trainer {
namespace {

/// Weight of the irises beside the coefficients, and the difference [rad] from which on it counts
/// less.
constexpr double iris_weight = 0.5, far_off = 10 * degree;
/// Border around the lids, over their width, so that skin is seen beside them.
constexpr double border = 0.3;

/// The part of a picture that shows an eye.
struct EyePart {
    Image<float> picture;
    Columns<float> eye; ///< 1 x pixels: 1 between the lids
    Pinhole<double> camera;
};

/// Returns true if a point lies within the lids, by the crossings of a ray to the right.
bool between_lids(const TrackedPicture& p, std::size_t eye, const Vec2<double>& at) {
    bool inside = false;
    const auto& lids = face_lids[eye];
    for (std::size_t k = 0; k < lids.size(); ++k) {
        const Vec2<double> a = p.landmarks.col(lids[k]).head<2>(),
                           b = p.landmarks.col(lids[(k + 1) % lids.size()]).head<2>();
        if ((a.y() > at.y()) != (b.y() > at.y()) &&
            at.x() < a.x() + (b.x() - a.x()) * (at.y() - a.y()) / (b.y() - a.y()))
            inside = !inside;
    }
    return inside;
}

std::optional<EyePart> part_of(const TrackedPicture& p, const Image8& whole,
                               const Pinhole<double>& camera, std::size_t eye) {
    Vec2<double> low = Vec2<double>::Constant(1e9), high = -low;
    for (const int i : face_lids[eye]) {
        low = low.cwiseMin(Vec2<double>(p.landmarks.col(i).head<2>()));
        high = high.cwiseMax(Vec2<double>(p.landmarks.col(i).head<2>()));
    }
    const double around = border * (high.x() - low.x());
    const auto within = [](double x, int most) {
        return static_cast<int>(std::clamp(std::floor(x), 0.0, static_cast<double>(most)));
    };
    const int left = within(low.x() - around, whole.width),
              top = within(low.y() - around, whole.height),
              right = within(high.x() + around, whole.width),
              bottom = within(high.y() + around, whole.height);
    const int w = right - left, h = bottom - top;
    constexpr int least = 8; // pixels a side
    if (w < least || h < least) return std::nullopt;
    EyePart part{Image<float>(w, h, 3), Columns<float>::Zero(1, static_cast<Index>(w) * h), camera};
    part.camera.cx -= left;
    part.camera.cy -= top;
    part.camera.width = w;
    part.camera.height = h;
    for (int y = 0; y < h; ++y)
        for (int x = 0; x < w; ++x) {
            const Index to = static_cast<Index>(y) * w + x;
            const auto from =
                3 * (static_cast<std::size_t>(top + y) * static_cast<std::size_t>(whole.width) +
                     static_cast<std::size_t>(left + x));
            for (Index c = 0; c < 3; ++c)
                part.picture.pixels(c, to) =
                    static_cast<float>(whole.values[from + static_cast<std::size_t>(c)]) / 255;
            const Vec2<double> at(left + x + 0.5, top + y + 0.5);
            part.eye(0, to) = between_lids(p, eye, at) ? 1.0f : 0.0f;
        }
    return part;
}

/// Angles (pitch, yaw) of both eyes in a picture, where their irises are found [rad].
using SeenEyes = std::array<std::optional<Vec2<double>>, 2>;

SeenEyes seen_in(const TrackedPicture& p, const Tracks& tracks, const VideoHead& head,
                 const VideoPose& pose) {
    const Image8 whole = read_image8(p.picture, 3);
    require(whole.width == tracks.width && whole.height == tracks.height, p.picture.string(), "is ",
            whole.width, " x ", whole.height, " pixels, expected ", tracks.width, " x ",
            tracks.height, " as in tracks.jsonl");
    SeenEyes seen;
    for (std::size_t e = 0; e < 2; ++e) {
        const std::optional<EyePart> part = part_of(p, whole, head.camera, e);
        if (!part) continue;
        const VideoEye& eye = head.eyes[e];
        const EyeballGeometry ball{pose.world_from_head.apply(eye.centre), eye.radius,
                                   eye.limbus_radius, pose.world_from_head.rotation,
                                   eye.iris_plane};
        const auto found =
            estimate_gaze(part->picture, part->eye, part->camera, ball, own_area_error);
        if (found) seen[e] = pitch_yaw(found->gaze);
    }
    return seen;
}

} // namespace

VideoGazes correct_gazes(const Tracks& tracks, VideoHead& head) {
    std::vector<SeenEyes> seen(head.poses.size());
    program_threads().run(static_cast<Index>(seen.size()), [&](Index i) {
        const VideoPose& pose = head.poses[static_cast<std::size_t>(i)];
        seen[static_cast<std::size_t>(i)] =
            seen_in(tracks.pictures[static_cast<std::size_t>(pose.picture)], tracks, head, pose);
    });
    // Differences of irises from coefficients: pitches of both eyes together, yaws of each.
    std::vector<double> pitch;
    std::array<std::vector<double>, 2> yaw;
    for (std::size_t i = 0; i < seen.size(); ++i)
        for (std::size_t e = 0; e < 2; ++e)
            if (seen[i][e]) {
                const Vec2<double> off = *seen[i][e] - pitch_yaw(head.poses[i].gaze[e]);
                pitch.push_back(off[0]);
                yaw[e].push_back(off[1]);
            }
    VideoGazes said{static_cast<int>(pitch.size()), 0};
    if (pitch.size() < seen.size() || yaw[0].empty() || yaw[1].empty()) return said;
    const double up = median(pitch);
    said.up_deg = up / degree;
    const std::array<double, 2> aside{median(yaw[0]), median(yaw[1])};
    for (std::size_t i = 0; i < seen.size(); ++i) {
        std::array<Vec3<double>, 2>& gaze = head.poses[i].gaze;
        Vec2<double> off = Vec2<double>::Zero(); // of both eyes, which turn alike
        double sum = 0;
        for (std::size_t e = 0; e < 2; ++e) {
            if (!seen[i][e]) continue;
            const Vec2<double> own = *seen[i][e] - pitch_yaw(gaze[e]) - Vec2<double>(up, aside[e]);
            const double weight = std::min(1.0, far_off / std::max(own.norm(), 1e-9));
            off += weight * own;
            ++sum;
        }
        if (sum > 0) off *= iris_weight / sum;
        for (Vec3<double>& axis : gaze) {
            const Vec2<double> angles = pitch_yaw(axis) + Vec2<double>(up, 0) + off;
            axis = gaze_vector(angles[0], angles[1]);
        }
    }
    return said;
}

} // namespace rye::trainer
