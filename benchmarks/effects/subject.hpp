// SPDX-License-Identifier: Apache-2.0
/// benchmarks/effects/subject.hpp: the avatar of the timed frames: a trained one (--avatar FILE; or
/// --run DIR, --capture DIR, or RYE_RUN and RYE_DATA), or else a synthetic one of the same sizes.
#pragma once

#include <string>

#include <rye/avatar/trained.hpp>
#include <rye/geometry/camera.hpp>

namespace rye::bench {

/// Options of the command line; empty: the environment's, or none.
struct SubjectOptions {
    std::string run, capture, avatar;
};
SubjectOptions& subject_options();

struct Subject {
    std::string name;              ///< for the output
    TrainedAvatar<float> avatar;
    AvatarConfig config;
    LandmarkRoles roles;
    Drivers<float, TrainedEffects> drivers;
    Pinhole<float> camera;         ///< of the render
    VecX<float> background;
};

/// The same for every benchmark of a process.
const Subject& subject();

} // namespace rye::bench
