// SPDX-License-Identifier: Apache-2.0
/// model/trained_parts.hpp: the parts that a configuration adds to the paper's effects: kappa,
/// driven eyes, shading, colours by the view.
#pragma once

#include "data/config.hpp"
#include "model/types.hpp"

namespace rye::trainer {

/// Gives the avatar the parts of the configuration at the beginning of a run, without a change of
/// its looks. normals: of the face's Gaussians, 3 x N; empty for shapes alone, which do not depend
/// on the number of points. Adds none for a run with another gaze mechanism than rotation: the
/// ComparedAvatar has them.
void begin_parts(Avatar& avatar, const TrainConfig& config, const Columns<float>& normals,
                 const Random& random);

/// Throws an Error that begins with `who` unless the kappa fits the configuration.
void require_kappa_fits(const Avatar& avatar, const TrainConfig& config, const std::string& who);

} // namespace rye::trainer
