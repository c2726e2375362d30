// SPDX-License-Identifier: Apache-2.0
/// training/trained_parts.hpp: the parts of an avatar that a configuration has on beside the
/// paper's effects: kappa, driven eyes, shading.
#pragma once

#include "data/config.hpp"
#include "training/types.hpp"

namespace rye::trainer {

/// Gives the avatar the parts that the configuration has on, as a run begins: it looks as it did.
/// The normals of the face's Gaussians are 3 x N; of none for shapes alone, which do not depend on
/// the number of points. Of a run by another gaze mechanism than rotation there are none: they are
/// the ComparedAvatar's.
void begin_parts(Avatar& avatar, const TrainConfig& config, const Columns<float>& normals,
                 const Random& random);

/// Throws Error, beginning with `who`, unless the kappa fits the configuration.
void require_kappa_fits(const Avatar& avatar, const TrainConfig& config, const std::string& who);

} // namespace rye::trainer
