// SPDX-License-Identifier: Apache-2.0
/// tests/support/unit_tetrahedron.hpp: the grid of one tetrahedron.
#pragma once

#include <rye/geometry/tet_grid.hpp>

namespace rye::test {

/// Returns the tetrahedron of the origin and the three unit vectors.
inline TetGrid<double> unit_tet() {
    TetGrid<double> g;
    g.vertices.resize(3, 4);
    g.vertices << 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1;
    g.topology = tet_topology(4, {{0, 1, 2, 3}});
    return g;
}

} // namespace rye::test
