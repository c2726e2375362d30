// SPDX-License-Identifier: Apache-2.0
/// training/run_size.hpp: how large a training run will be, before it begins: a setting that
/// asks for more than the machine has is refused at once, not after hours, and not by the system.
#pragma once

#include <string>

#include "data/samples.hpp"

namespace rye::trainer {

struct RunSize {
    double lattice = 0;    ///< vertices of the largest lattice
    double gaussians = 0;  ///< about; the face's depend on the surface that stage 1 finds
    double most = 0;       ///< those and what gaussians.density may add
    double bytes = 0;      ///< of memory, at least
};

/// The neutral surface as it is taken to be before stage 1 has found it: a sphere of radius 1 that
/// the landmarks lie on, and has as many more vertices as heads have more surface.
struct SurfaceGuess {
    Columns<double> points; ///< 3 x N, on the sphere
    VecX<double> vertices; ///< of the surface that each stands for, N; edges near eyes and lips are
                           ///< as short as the configuration has them
    Columns<double> landmarks; ///< all of the subject's, on the sphere, 3 x L
};
SurfaceGuess surface_guess(const TrainConfig& config, const Subject& subject);

/// width, height: of the capture's pictures [px].
RunSize run_size(const TrainConfig& config, const Subject& subject, int width, int height);

/// Memory that this process may have: the machine's, or less by a limit of the process [bytes].
double most_memory();

/// Error, beginning with `who`, if it is certainly more than `memory` [bytes].
void require_room(const RunSize& size, double memory, const std::string& who);

/// "about 5000 Gaussians, at least 0.3 GB of memory".
std::string text_of(const RunSize& size);

} // namespace rye::trainer
