// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/gaze_at.hpp: gazes of an avatar's eyes that meet at a point, from where its drivers
/// put the eyeballs, by its kappa. Frames: world, and the head's in canonical units.
/// Source: rig/gaze_at.hpp; the centres: paper eq. (10), as avatar/eye_stream.hpp draws them.
#pragma once

#include <array>

#include <rye/avatar/eye_parameters.hpp>
#include <rye/avatar/head_pose.hpp>
#include <rye/rig/gaze_at.hpp>

namespace rye {

/// Returns the centres of the left and the right eyeball in the head's frame, with the offset of
/// these drivers: about them the eyes are drawn. They do not depend on the gazes.
template <class T, EffectSet E, EffectSet D, Backend B>
std::array<Vec3<T>, 2> driven_eye_centres(const B& backend, const EyeStream<T, E>& eyes,
                                          const AvatarConfig& config,
                                          const Drivers<T, D>& drivers) {
    std::array<Vec3<T>, 2> centre{Vec3<T>(eyes.centre.col(0)), Vec3<T>(eyes.centre.col(1))};
    if constexpr (has_effect<E, EyeOffset>) {
        EyeOffsetTrace<T> trace;
        const Columns<T> offset = eye_offset<T>(
            backend, eyes.offset, config, frame_code(config, OpticalDrivers<T, D>(drivers)), trace);
        for (std::size_t e = 0; e < 2; ++e) centre[e] += offset.col(static_cast<Index>(e));
    }
    return centre;
}

/// Returns the kappa of both eyes; 0 for an avatar without one.
template <class T, EffectSet E>
std::array<KappaAngles<T>, 2> kappas_of(const EyeStream<T, E>& eyes) {
    if constexpr (has_effect<E, Kappa>)
        if (eyes.kappa.size() > 0)
            return {detail::kappa_of(eyes.kappa, 0), detail::kappa_of(eyes.kappa, 1)};
    return {};
}

/// Returns where the drivers put the head.
template <class T, EffectSet D>
    requires has_effect<D, HeadPose>
HeadPlacement<T> head_placement(const Drivers<T, D>& drivers) {
    const HeadTransform<T> t = head_transform(drivers);
    return {{t.rotation, t.translation}, t.scale};
}

/// Returns the gazes of both eyes that meet at a target of the head's frame (target_in_head makes
/// one of the world's). Of an avatar with a kappa the `visual` ones are the drivers' gazes and meet
/// there; without one both axes are the same, the drivers' optical ones. `range` [rad] as in
/// aim_eyes.
template <class T, EffectSet E, EffectSet D, Backend B>
AimedEyes<T> gazes_at(const B& backend, const EyeStream<T, E>& eyes, const AvatarConfig& config,
                      const Drivers<T, D>& drivers,
                      const std::type_identity_t<GazeTarget<T>>& target,
                      const std::type_identity_t<T>& range = constant<T>(gaze_range)) {
    return aim_eyes(driven_eye_centres(backend, eyes, config, drivers), target, kappas_of(eyes),
                    range);
}

} // namespace rye
