// SPDX-License-Identifier: Apache-2.0
/// training/types.hpp: the policies that the reference trainer is built from, in one place.
#pragma once

#include <rye/avatar/guidance_mesh.hpp>
#include <rye/avatar/two_stream.hpp>
#include <rye/rig/eyeball.hpp>
#include <rye/splat/lanes.hpp>

#include "data/threads.hpp"

namespace rye::trainer {

using TrainBackend = XsimdBackend<DefaultArch, ProgramThreads>;
using TrainRasterizer = Rasterizer<FeaturesOnly<Balanced>>;
using TrainEffects = PaperEffects;
using Mesh = GuidanceMesh<float, TrainEffects>;
using Avatar = TwoStream<float, TrainEffects>;
using TrainEyeball = BasicEyeballShape<TrainEffects>;
/// The avatar that is trained by lines of sight.
using VisualEffects = More<TrainEffects, Kappa>;
using VisualAvatar = TwoStream<float, VisualEffects>;

/// The backend on the program's threads.
inline TrainBackend train_backend() { return {program_threads()}; }

} // namespace rye::trainer
