// SPDX-License-Identifier: Apache-2.0
/// model/types.hpp: the policies of the reference trainer.
#pragma once

#include <rye/avatar/guidance_mesh.hpp>
#include <rye/avatar/two_stream.hpp>
#include <rye/rig/eyeball.hpp>
#include <rye/splat/lanes.hpp>

#include "data/memory_limit.hpp"
#include "data/threads.hpp"
#include "model/effects.hpp"

namespace rye::trainer {

using TrainBackend = XsimdBackend<DefaultArch, ProgramThreads>;
using TrainRasterizer = Rasterizer<FeaturesOnly<Balanced>>;
using Mesh = GuidanceMesh<float, MeshEffects>;
using TrainEyeball = BasicEyeballShape<MeshEffects>;

/// Returns the backend on the program's threads.
inline TrainBackend train_backend() { return {program_threads()}; }

/// Dilation of trainings, and of pictures where the head is as large as in theirs [px^2].
inline constexpr double trained_dilation = Balanced{}.dilation;

/// Returns the rasterizer of trainings and pictures of runs, whose lists take at most
/// memory_limit().
inline TrainRasterizer train_rasterizer(double dilation = trained_dilation) {
    TrainRasterizer rasterizer;
    rasterizer.accuracy.dilation = dilation;
    rasterizer.accuracy.max_memory = memory_limit();
    return rasterizer;
}

} // namespace rye::trainer
