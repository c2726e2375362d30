// SPDX-License-Identifier: Apache-2.0
#include "drawing/playable.hpp"

#include <rye/avatar/hold.hpp>
#include <rye/rig/gaze.hpp>

namespace rye::trainer {
namespace {

/// Extends the ranges by one more set of drivers.
void extend(DriverRanges<float>& r, const Drivers<float>& d) {
    r.expression_low = r.expression_low.cwiseMin(d.expression).eval();
    r.expression_high = r.expression_high.cwiseMax(d.expression).eval();
    for (std::size_t eye = 0; eye < 2; ++eye) {
        const auto e = static_cast<Index>(eye);
        const Vec2<float> angles = pitch_yaw(d.gaze[eye]);
        r.gaze_low.col(e) = r.gaze_low.col(e).cwiseMin(angles).eval();
        r.gaze_high.col(e) = r.gaze_high.col(e).cwiseMax(angles).eval();
    }
}

} // namespace

DriverRanges<float> driver_ranges(const Capture& capture, GazeAxis axis,
                                  const Drivers<float>& rest) {
    DriverRanges<float> ranges;
    ranges.expression_low = ranges.expression_high = rest.expression;
    for (std::size_t eye = 0; eye < 2; ++eye) {
        const auto e = static_cast<Index>(eye);
        ranges.gaze_low.col(e) = ranges.gaze_high.col(e) = pitch_yaw(rest.gaze[eye]);
    }
    for (const int f : capture.train) extend(ranges, frame_drivers(capture, f, axis));
    return ranges;
}

PlayableAvatar<float> playable_avatar(const TrainState& state, const Capture& capture, int frame,
                                      int camera) {
    require(!state.compared, "rye export",
            "got a run whose avatar.gaze_mechanism is '" + word_of(state.config.gaze_mechanism) +
                "', expected 'rotation': a .avatar holds eyes that rotate");
    const GazeAxis axis = state.config.gaze_axis;
    PlayableAvatar<float> p;
    p.name = capture.subject;
    p.config = state.config.avatar;
    p.roles = state.subject.roles;
    p.avatar = state.avatar;
    if (axis == GazeAxis::optical) p.avatar.eyes.kappa = {}; // its angles are 0
    p.avatar.delta_gaze = {};                                // corrects training frames alone
    p.expression_names = capture.expression_names;
    p.neutral = frame_drivers(capture, frame, axis);
    p.ranges = driver_ranges(capture, axis, p.neutral);
    p.camera = capture.camera(frame, camera).cast<float>();
    p.background = VecX<float>::Ones(p.config.channels);
    return p;
}

} // namespace rye::trainer
