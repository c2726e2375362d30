// SPDX-License-Identifier: Apache-2.0
/// importers/flame.hpp: facts of FLAME's topology, and meshes in OBJ files. No FLAME model file is
/// read: vertices are numbered from 0 in the order of its template.
/// Source: FLAME (Li et al., 2017), 5023 vertices of which the last 2 x 546 are the eyeballs; VHAP
/// appends 120 vertices of teeth. The landmarks are the vertices next to its static embedding of
/// 68 points, jaw included.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include <rye/geometry/mesh.hpp>

namespace rye::trainer {

inline constexpr Index flame_vertices = 5023;
inline constexpr Index flame_vertices_with_teeth = 5143;

/// First and last vertex of the left (x > 0) and of the right eyeball.
inline constexpr std::array<int, 4> flame_eyeballs{3931, 4476, 4477, 5022};

/// Vertices of the 68 landmarks, in the order of iBUG.
inline constexpr std::array<int, 68> flame_landmarks{
    2210, 1963, 3056, 3424, 3423, 3421, 3419, 3416, 3414, 3635, 3643, 3646, 3650, 3652,
    2004, 568,  728,  2567, 337,  338,  3154, 3712, 3868, 2135, 27,   18,   1430, 3560,
    3561, 3501, 3564, 2751, 2793, 3556, 1676, 1623, 2428, 2453, 2494, 3631, 2278, 2359,
    3832, 1343, 1218, 1154, 995,  829,  2820, 2864, 2774, 3543, 1657, 1749, 1703, 1774,
    1802, 3503, 2905, 2881, 2845, 2787, 3531, 1670, 1730, 1804, 3504, 2907};

/// Returns the vertices and triangles of an OBJ file; cuts polygons into fans, ignores normals and
/// texture. Throws an Error, with file (`name`), line and value, for anything that is not such a
/// mesh.
TriangleMesh<double> parse_obj(std::string_view text, const std::string& name);
TriangleMesh<double> read_obj(const std::filesystem::path& path);

} // namespace rye::trainer
