// SPDX-License-Identifier: Apache-2.0
/// data/eye_shapes.hpp: sizes of an eyeball from a capture, and the shape for training. Lengths in
/// canonical units.
#pragma once

#include <string>

#include <rye/rig/eyeball.hpp>

#include "data/capture.hpp"

namespace rye::trainer {

struct EyeSizes {
    double radius, limbus_radius, iris_plane;  ///< iris_plane: z of the iris' middle
};

/// Returns the sizes, with textbook proportions for missing values; `scale` is the frame's, head to
/// world.
EyeSizes eye_sizes(const CaptureEye& eye, double scale, double default_radius);

EyeballShape eyeball_shape(const EyeSizes& sizes);

/// Throws an Error that begins with `who` if these sizes make no eyeball.
void require_eyeball(const EyeSizes& sizes, const std::string& who);

} // namespace rye::trainer
