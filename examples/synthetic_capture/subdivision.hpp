// SPDX-License-Identifier: Apache-2.0
/// synthetic_capture/subdivision.hpp: one step of Catmull-Clark subdivision as a linear map, so
/// that displacements are subdivided as positions are.
/// Source: Catmull and Clark, Recursively generated B-spline surfaces, 1978.
#pragma once

#include <Eigen/SparseCore>

#include "synthetic_capture/makehuman_files.hpp"

namespace rye::trainer {

struct Subdivision {
    Eigen::SparseMatrix<double>
        weights;             ///< V x V', the first V of V' moved; for vertices * weights
    Columns<double> uv;      ///< 2 x U'
    std::vector<Quad> faces; ///< four for each face, in its order
};

/// Subdivides once; borders of the mesh stay borders. Texture coordinates are interpolated
/// linearly.
Subdivision subdivided(Index vertices, const Columns<double>& uv, const std::vector<Quad>& faces);

} // namespace rye::trainer
