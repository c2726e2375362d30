// SPDX-License-Identifier: Apache-2.0
// Triangles are drawn by a pinhole: a lens would be left out without a word.
// expect: (cannot convert|conversion|invalid initialization|no matching function)
#include <rye/geometry/screen_mesh.hpp>

#if REJECT
using Camera = rye::Pinhole<double, rye::BrownConrady<double>>;
#else
using Camera = rye::Pinhole<double>;
#endif

rye::ScreenMesh<double> drawn(const rye::Columns<double>& vertices, const Camera& camera) {
    return rye::screen_mesh<double>(rye::Serial{}, vertices, camera);
}
