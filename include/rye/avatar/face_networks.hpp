// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/face_networks.hpp: the networks that both stages share and stage 2 inherits from
/// stage 1: colour and deformation by expression, head pose and each eye's gaze.
/// Source: paper sections 3.2 and 3.3; sizes in avatar/config.hpp.
#pragma once

#include <array>

#include <rye/avatar/drivers.hpp>
#include <rye/core/fields.hpp>

namespace rye {

template <class T>
struct FaceNetworks {
    Mlp<T> exp_color, pose_color, exp_deform, pose_deform;
    std::array<Mlp<T>, 2> gaze_deform, gaze_color;  ///< left, right

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        nested_fields<Mlp<T>>("exp_color_mlp", f, p.exp_color...);
        nested_fields<Mlp<T>>("pose_color_mlp", f, p.pose_color...);
        nested_fields<Mlp<T>>("exp_deform_mlp", f, p.exp_deform...);
        nested_fields<Mlp<T>>("pose_deform_mlp", f, p.pose_deform...);
        nested_fields<Mlp<T>>("leftgaze_deform_mlp", f, p.gaze_deform[0]...);
        nested_fields<Mlp<T>>("rightgaze_deform_mlp", f, p.gaze_deform[1]...);
        nested_fields<Mlp<T>>("leftgaze_color_mlp", f, p.gaze_color[0]...);
        nested_fields<Mlp<T>>("rightgaze_color_mlp", f, p.gaze_color[1]...);
    }

    static FaceNetworks init(const AvatarConfig& c, const Random& random) {
        const int xyz = c.position_code(), pose = c.pose_code(), gaze = c.gaze_code();
        const auto make = [&](int points, int frame, const std::vector<int>& hidden, int out,
                              std::uint64_t key) {
            return driven_mlp<T>(c, mlp_shape(points, frame, hidden, out), random.fork(key));
        };
        FaceNetworks n;
        n.exp_color = make(c.feature, c.expression, c.networks.exp_color, c.channels, 1);
        n.pose_color = make(c.feature, pose, c.networks.pose_color, c.channels, 2);
        n.exp_deform = make(xyz, c.expression, c.networks.exp_deform, 3, 3);
        n.pose_deform = make(xyz, pose, c.networks.pose_deform, 3, 4);
        for (std::size_t eye = 0; eye < 2; ++eye) {
            n.gaze_deform[eye] = make(xyz, gaze, c.networks.gaze_deform, 3, 5 + eye);
            n.gaze_color[eye] = make(c.feature, gaze, c.networks.gaze_color, c.channels, 7 + eye);
        }
        return n;
    }
};

} // namespace rye
