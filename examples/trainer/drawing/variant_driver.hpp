// SPDX-License-Identifier: Apache-2.0
/// drawing/variant_driver.hpp: the code compiled for each variant of variant_list.hpp: an avatar
/// with fewer effects, made of the trained one, and its driven Gaussians.
#pragma once

#include <functional>
#include <memory>

#include <rye/avatar/hold.hpp>

#include "model/types.hpp"

namespace rye::trainer {

/// A frame's drivers, whose gazes are of the run's gaze_axis, with the camera that sees it.
using SeenDrivers = Drivers<float, TrainEffects>;
/// Returns the driven Gaussians of a frame, the face's first, world units.
using FrameDriver = std::function<Gaussians<float>(const SeenDrivers&)>;

/// Returns the driver of a variant's avatar; effects that it lacks are held at the drivers `at`.
/// `avatar`, `config` and `roles` must outlive the driver.
template <EffectSet E>
FrameDriver driver_of(const Avatar& avatar, const AvatarConfig& config, const LandmarkRoles& roles,
                      const SeenDrivers& at) {
    std::shared_ptr<const TwoStream<float, E>> own;
    if constexpr (std::same_as<E, TrainEffects>)
        own = {std::shared_ptr<void>(), &avatar};  // no effect is held
    else
        own = std::make_shared<TwoStream<float, E>>(
            held<E>(train_backend(), avatar, config, roles, at));
    return [own, &config, &roles](const SeenDrivers& drivers) {
        TwoStreamTrace<float, E> trace;
        drive(train_backend(), *own, {config, roles, restricted<E>(drivers)}, trace);
        return std::move(trace.gaussians);
    };
}

} // namespace rye::trainer
