// SPDX-License-Identifier: Apache-2.0
/// examples/trainer/types.hpp: the policies that the reference trainer is built from, in one place.
#pragma once

#include <rye/avatar/guidance_mesh.hpp>
#include <rye/avatar/two_stream.hpp>
#include <rye/backend/xsimd.hpp>
#include <rye/splat/rasterizer.hpp>

namespace rye::trainer {

using TrainBackend = XsimdBackend<>;
using TrainRasterizer = Rasterizer<TrainBackend, Balanced>;
using Mesh = GuidanceMesh<float>;
using Avatar = TwoStream<float>;

} // namespace rye::trainer
