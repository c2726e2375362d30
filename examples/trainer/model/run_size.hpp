// SPDX-License-Identifier: Apache-2.0
/// model/run_size.hpp: estimate of a training run's size before it begins: a setting that needs
/// more than the machine has is refused at once, not after hours, and not by the system.
#pragma once

#include <string>

#include "data/samples.hpp"

namespace rye::trainer {

struct RunSize {
    double lattice = 0;    ///< vertices of the largest lattice
    double gaussians = 0;  ///< approximate; the face's depend on the surface of stage 1
    double most = 0;       ///< with the most that gaussians.density may add
    double bytes = 0;      ///< memory, at least
};

/// Assumed neutral surface before stage 1: a sphere of radius 1 on which the landmarks lie, with as
/// many more vertices as heads have more surface.
struct SurfaceGuess {
    Columns<double> points; ///< 3 x N, on the sphere
    VecX<double> vertices; ///< number of the surface's vertices that each stands for, N;
                           ///< edges near eyes and lips are as short as configured
    Columns<double> landmarks; ///< all landmarks of the subject, on the sphere, 3 x L
};
SurfaceGuess surface_guess(const TrainConfig& config, const Subject& subject);

/// Returns the size of a run. width, height: of the capture's pictures [px].
RunSize run_size(const TrainConfig& config, const Subject& subject, int width, int height);

/// Throws an Error that begins with `who` if the run certainly needs more than `memory` [bytes].
void require_room(const RunSize& size, double memory, const std::string& who);

/// Returns a text such as "about 5000 Gaussians, at least 0.3 GB of memory".
std::string text_of(const RunSize& size);

} // namespace rye::trainer
