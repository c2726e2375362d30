// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/face_networks.hpp: the networks that both stages share and stage 2 inherits from
/// stage 1: colour and deformation by expression, head pose and each eye's gaze.
/// Source: paper sections 3.2 and 3.3; sizes in avatar/config.hpp.
#pragma once

#include <rye/avatar/drivers.hpp>
#include <rye/avatar/face_fields.hpp>
#include <rye/core/fields.hpp>

namespace rye {

/// The networks of a face's colours and deformations, one for each driver that E has.
template <class T, EffectSet E = PaperEffects>
struct FaceNetworks : detail::FaceFields<detail::NetworkOf<T, E>, E> {
    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        if constexpr (has_effect<E, Expression>)
            detail::nested_fields<detail::NetworkOf<T, E>>("exp_color_mlp", f, p.exp_color...);
        if constexpr (has_effect<E, PoseResidual>)
            detail::nested_fields<detail::NetworkOf<T, E>>("pose_color_mlp", f, p.pose_color...);
        if constexpr (has_effect<E, Expression>)
            detail::nested_fields<detail::NetworkOf<T, E>>("exp_deform_mlp", f, p.exp_deform...);
        if constexpr (has_effect<E, PoseResidual>)
            detail::nested_fields<detail::NetworkOf<T, E>>("pose_deform_mlp", f, p.pose_deform...);
        if constexpr (detail::skin_follows<E, 0>)
            detail::nested_fields<detail::NetworkOf<T, E>>("leftgaze_deform_mlp", f,
                                                           of_eye<0>(p.gaze_deform)...);
        if constexpr (detail::skin_follows<E, 1>)
            detail::nested_fields<detail::NetworkOf<T, E>>("rightgaze_deform_mlp", f,
                                                           of_eye<1>(p.gaze_deform)...);
        if constexpr (detail::skin_follows<E, 0>)
            detail::nested_fields<detail::NetworkOf<T, E>>("leftgaze_color_mlp", f,
                                                           of_eye<0>(p.gaze_color)...);
        if constexpr (detail::skin_follows<E, 1>)
            detail::nested_fields<detail::NetworkOf<T, E>>("rightgaze_color_mlp", f,
                                                           of_eye<1>(p.gaze_color)...);
    }

    static FaceNetworks init(const AvatarConfig& c, const Random& random) {
        const int xyz = c.position_code<detail::NetworksOf<E>>(),
                  pose = c.pose_code<detail::NetworksOf<E>>(),
                  gaze = c.gaze_code<detail::NetworksOf<E>>();
        const auto make = [&](int points, int frame, const std::vector<int>& hidden, int out,
                              std::uint64_t key) {
            return driven_mlp<T, detail::NetworksOf<E>>(c, mlp_shape(points, frame, hidden, out),
                                                        random.fork(key));
        };
        FaceNetworks n;
        if constexpr (has_effect<E, Expression>) {
            n.exp_color = make(c.feature, c.expression, c.networks.exp_color, c.channels, 1);
            n.exp_deform = make(xyz, c.expression, c.networks.exp_deform, 3, 3);
        }
        if constexpr (has_effect<E, PoseResidual>) {
            n.pose_color = make(c.feature, pose, c.networks.pose_color, c.channels, 2);
            n.pose_deform = make(xyz, pose, c.networks.pose_deform, 3, 4);
        }
        for_eyes([&]<std::size_t eye>() {
            if constexpr (detail::skin_follows<E, eye>) {
                of_eye<eye>(n.gaze_deform) = make(xyz, gaze, c.networks.gaze_deform, 3, 5 + eye);
                of_eye<eye>(n.gaze_color) =
                    make(c.feature, gaze, c.networks.gaze_color, c.channels, 7 + eye);
            }
        });
        return n;
    }
};

} // namespace rye
