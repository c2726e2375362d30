// SPDX-License-Identifier: Apache-2.0
#include "synthetic_capture/video_scene.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <rye/core/error.hpp>
#include <rye/core/random.hpp>
#include <rye/math/rotation.hpp>

namespace rye::trainer {
namespace {

constexpr double degree = std::numbers::pi / 180;
constexpr double seconds_of_expression = 1.2, seconds_of_fixation = 0.5;
constexpr double reach_yaw_deg = 24, reach_pitch_deg = 16;

/// Weights of the expression at a time [s]: from one of the drawn expressions to the next.
VecX<double> expression_at(double seconds, const std::vector<std::string>& names,
                           const Random& random) {
    const auto drawn = [&](int i) {
        return i == 0 ? VecX<double>(VecX<double>::Zero(static_cast<Index>(names.size())))
                      : random_expression(names, random.fork(static_cast<std::uint64_t>(i)));
    };
    const double at = seconds / seconds_of_expression;
    const int i = static_cast<int>(std::floor(at));
    const double s = at - i, smooth = s * s * (3 - 2 * s);
    return (1 - smooth) * drawn(i) + smooth * drawn(i + 1);
}

/// Share of its motion that the head has at a time [s]: it begins at rest, stays nearly still for a
/// time, and then begins to move.
double motion_at(double seconds, double still_until) {
    constexpr double still = 0.15, seconds_of_change = 2;
    const double begin = std::min(1.0, seconds);
    const double since = std::clamp((seconds - still_until) / seconds_of_change, 0.0, 1.0);
    return begin * std::lerp(still, 1.0, since);
}

Vec<double, 6> pose_at(double seconds, const VideoSettings& v) {
    const auto wave = [&](double period, double phase) {
        return std::sin(2 * std::numbers::pi * (seconds / period + phase));
    };
    Vec<double, 6> pose;
    pose << v.nod_deg * degree * wave(5.2, 0.1), v.turn_deg * degree * wave(8, 0),
        v.tilt_deg * degree * wave(3.7, 0.3), 0.12 * wave(6.1, 0), 0.08 * wave(4.3, 0.2),
        0.25 * wave(7.3, 0.4);
    return pose;
}

/// Returns where a camera at `at`, held in a hand, has gone at a time [s]: what takes points of its
/// place at rest to those of its place now.
Rigid<double> sway_at(double seconds, const Vec3<double>& at) {
    const auto wave = [&](double period, double phase) {
        const double turns = seconds / period + phase;
        return 0.8 * std::sin(2 * std::numbers::pi * turns) +
               0.2 * std::sin(2 * std::numbers::pi * 7.3 * turns); // the hand trembles
    };
    const Mat3<double> turn = so3_exp(Vec3<double>(
        2 * degree * Vec3<double>(wave(3.1, 0.2), wave(4.3, 0.6), 0.5 * wave(5.9, 0.4))));
    const Vec3<double> shift = 0.2 * Vec3<double>(wave(3.7, 0), wave(2.9, 0.3), wave(6.7, 0.8));
    return {turn, at + shift - turn * at};
}

/// Returns until when the head is nearly still [s]: for a third of the dots' time; without any, not
/// at all.
double end_of_stillness(const VideoSettings& v) {
    std::vector<double> with_dot;
    for (int i = 0; v.dot && i < v.frames; ++i)
        if (v.dot(static_cast<double>(i) / v.rate)) with_dot.push_back(static_cast<double>(i) / v.rate);
    return with_dot.empty() ? -1e3 : std::lerp(with_dot.front(), with_dot.back(), 1.0 / 3);
}

} // namespace

CaptureScene video_scene(const HeadModel& model, const CaptureSettings& settings,
                         const VideoSettings& v) {
    const auto check = [](const char* name, double value, double low, double high) {
        require(
            value >= low && value <= high, "capture --video", "got ",
            [&] { return std::to_string(value); }, " for ", name, ", expected ",
            [&] { return std::to_string(low); }, " to ", [&] { return std::to_string(high); });
    };
    check("the frames", v.frames, 2, 9000);
    check("the rate", v.rate, 1, 240);
    check("the camera's distance", v.distance, 3, 30);
    check("the focal length over the picture's edge", v.focal, 0.3, 10);
    check("the turn [deg]", v.turn_deg, 0, 80);
    CaptureSettings one = settings;
    one.cameras = 1;
    one.train_frames = v.frames;
    one.novel_frames = one.independent_frames = 0;
    CaptureScene scene = capture_scene(model, one);
    SceneCamera& c = scene.cameras.front();
    c.yaw_deg = c.pitch_deg = 0;
    c.distance = v.distance;
    c.camera = look_at<double>(head_centre + v.distance * Vec3<double>(0, 0, 1), head_centre,
                               {0, 1, 0}, 1.0, {one.size, one.size});
    c.camera.fx = c.camera.fy = v.focal * one.size;
    const Random random{one.seed, 109};
    const double still_until = end_of_stillness(v);
    for (int i = 0; i < v.frames; ++i) {
        SceneFrame& f = scene.frames[static_cast<std::size_t>(i)];
        const double seconds = static_cast<double>(i) / v.rate;
        f.kind = i % 5 == 4 ? FrameKind::novel : FrameKind::train;
        f.pose = motion_at(seconds, still_until) * pose_at(seconds, v);
        f.state.expression = expression_at(seconds, model.expression_names, random.fork(1));
        f.state.world_from_head = {so3_exp(Vec3<double>(f.pose.head<3>())), f.pose.tail<3>()};
        if (v.hand_held) {
            const Rigid<double> still = sway_at(seconds, c.camera.centre()).inverse();
            f.state.world_from_head = compose(still, f.state.world_from_head);
            f.state.world_from_lights = still.rotation;
            f.pose << so3_log(f.state.world_from_head.rotation), f.state.world_from_head.translation;
        }
        const int look = static_cast<int>(seconds / seconds_of_fixation);
        const Random of_look = random.fork(2).fork(static_cast<std::uint64_t>(look));
        f.fixation_deg =
            look == 0 ? Vec2<double>(0, 0)
                      : Vec2<double>(reach_yaw_deg * (2 * of_look.uniform(0) - 1),
                                     reach_pitch_deg * (2 * of_look.uniform(1) - 1));
        const auto dot = v.dot ? v.dot(seconds) : std::nullopt;
        if (!dot) {
            place_eyes(f, model, scene);
            continue;
        }
        f.fixation_deg.reset();
        const Vec3<double> at = c.camera.centre() + unit_per_mm * Vec3<double>(-dot->x(), dot->y(), 0);
        look_at_target(f, model, scene, f.state.world_from_head.inverse().apply(at));
    }
    return scene;
}

} // namespace rye::trainer
