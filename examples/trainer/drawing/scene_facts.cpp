// SPDX-License-Identifier: Apache-2.0
#include "drawing/scene_facts.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <rye/avatar/eye_offset.hpp>
#include <rye/avatar/rest_pose.hpp>
#include <rye/math/rotation.hpp>

namespace rye::trainer {

DriverFacts driver_facts(const TrainState& state, const std::vector<DrawnFrame>& frames) {
    DriverFacts d;
    d.lights = static_cast<int>(state.avatar.eyes.optics.lights());
    const auto gaze = [](const DrawnFrame& f, std::size_t e) {
        return Vec3<double>(f.drivers.gaze[e].cast<double>());
    };
    for (std::size_t e = 0; e < 2; ++e) d.rest[e] = gaze(frames.front(), e);
    for (const DrawnFrame& f : frames) {
        const Drivers<float>& at = f.drivers;
        const Vec<double, 6> pose = at.pose.cast<double>();
        const auto scale = static_cast<double>(at.scale);
        d.add({at.expression.begin(), at.expression.end()}, pose, scale);
        d.pupil.add(Vec2<double>(double(f.pupil[0]), double(f.pupil[1])));
        const Mat3<double> rotation = so3_exp(Vec3<double>(pose.head<3>()));
        const Pinhole<double> camera = f.camera.cast<double>();
        for (std::size_t e = 0; e < 2; ++e) {
            d.add_gaze(e, gaze(f, e));
            const Vec3<double> centre =
                scale * (rotation * state.subject.eye_centre[e]) + Vec3<double>(pose.tail<3>());
            const Vec3<double> px = camera.project_point(centre);
            if (!(px.z() > 0 && px.x() >= 0 && px.x() <= camera.width && px.y() >= 0 &&
                  px.y() <= camera.height))
                continue;
            ++d.eyes[e].views;
            d.eyes[e].iris = std::max(d.eyes[e].iris, 2 * scale * state.subject.limbus_radius[e] *
                                                          camera.fx / px.z());
        }
    }
    return d;
}

namespace {

/// Returns a bound on what view-dependent colours, 3K x N, add to any channel.
double most_view_color(const Columns<float>& colors) {
    const Index each = colors.rows() / 3;
    double most = 0;
    for (Index i = 0; i < colors.cols(); ++i)
        for (Index c = 0; c < 3; ++c) {
            double sum = 0;
            for (int l = 1; sh_count(l) - 1 <= each; ++l)
                sum += std::sqrt((2 * l + 1) / (4 * std::numbers::pi)) *
                       double(colors.col(i).segment(c * each + l * l - 1, 2 * l + 1).norm());
            most = std::max(most, sum);
        }
    return most;
}

} // namespace

AvatarFacts avatar_facts(const TrainState& state, const std::vector<Drivers<float>>& frames,
                         bool held_at_first) {
    AvatarFacts a;
    const AvatarConfig& config = state.config.avatar;
    const RestPose<float, TrainEffects> rest =
        rest_pose(train_backend(), state.avatar.face, config, state.subject.roles);
    const auto moved = [&](std::size_t d) { return static_cast<Index>(rest.moved[d].points.size()); };
    a.moved_by_expression = moved(0);
    a.moved_by_pose = moved(1);
    a.moved_by_gaze = {moved(2), moved(3)};
    Columns<float> from = Columns<float>::Zero(3, 2);
    const auto moves = [&](const Drivers<float>& d) {
        EyeOffsetTrace<float> trace;
        return eye_offset<float>(train_backend(), state.avatar.eyes.offset, config,
                                 frame_code(config, OpticalDrivers<float>(d)), trace);
    };
    if (held_at_first) from = moves(frames.front());
    for (const Drivers<float>& d : frames)
        a.eye_offset = std::max(
            a.eye_offset, static_cast<double>((moves(d) - from).colwise().norm().maxCoeff()));
    a.channels = config.channels;
    a.shaded = state.avatar.shading.any();
    a.corneas = state.avatar.eyes.optics.refracts();
    for (const Columns<float>* c : {&state.avatar.view_color.face, &state.avatar.view_color.eyes})
        a.view_color = std::max(a.view_color, most_view_color(*c));
    a.lid_shadow = state.avatar.eyes.has_lid_shadow();
    a.driven_eyes = has_driven_eyes(state.avatar);
    const Upsampler<float>& u = state.avatar.upsampler;
    a.refines = !u.shape.skip || (u.out_weight.array() != 0).any() || (u.out_bias.array() != 0).any();
    return a;
}

} // namespace rye::trainer
