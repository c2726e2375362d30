// SPDX-License-Identifier: Apache-2.0
/// synthetic_capture/head_grid.hpp: the closed skin of the procedural head as a grid of rows and
/// columns. Columns are longitudes about a vertical axis, rows go from the crown to the chest; the
/// vertices are where rays from inside meet the sculpted surface. One row follows the eyes, one the
/// mouth, and both are cut there: vertices between the corners exist twice, for upper and lower lid
/// or lip. Head frame and units of head_model.hpp.
#pragma once

#include <array>
#include <vector>

#include "synthetic_capture/head_model.hpp"
#include "synthetic_capture/head_sculpt.hpp"

namespace rye::trainer {

/// Directions from an eye's centre [rad]: azimuth from +z away from the nose, elevation upwards.
struct EyeAngles {
    double azimuth = 0, elevation = 0, distance = 0;
};
EyeAngles eye_angles(const Vec3<double>& from_centre); ///< of the left eye
Vec3<double> eye_direction(double azimuth, double elevation);

/// Lid corners of the left eye as seen from its centre; the closed lids meet between them.
struct EyeCorners {
    double inner_azimuth = 0, outer_azimuth = 0;     // [rad]
    double inner_elevation = 0, outer_elevation = 0; // [rad]
    /// 0 at the inner corner, 1 at the outer one.
    double along(double azimuth) const {
        return (azimuth - inner_azimuth) / (outer_azimuth - inner_azimuth);
    }
    double line(double azimuth) const {
        return inner_elevation +
               (outer_elevation - inner_elevation) * std::clamp(along(azimuth), -0.5, 1.5);
    }
};

/// A cut along a row, from one corner column to the other.
struct Slit {
    int row = 0;
    std::vector<Index> upper, lower; ///< vertices, corner to corner; the corners are in both
};

struct HeadGrid {
    int rows = 0, columns = 0;
    Points vertices; ///< the closed skin, then the doubles of the slits
    std::vector<Face> faces, face_uv;
    Columns<double> uv;       ///< 2 x (rows * (columns + 1) + 1)
    std::vector<int> row_of;  ///< of each vertex; doubles count as the row below
    std::array<Slit, 2> eyes; ///< inner to outer corner, of left and right eye
    Slit mouth;               ///< from the subject's right to the left
    EyeCorners corners;

    Index at(int row, int column) const {
        return 1 + static_cast<Index>(row) * columns + (column % columns + columns) % columns;
    }
};

/// Height of the line between the closed lips at a distance from the midline.
double mouth_line(double x);

/// First exit of the ray from a point inside the sculpted head.
Vec3<double> head_surface(const Vec3<double>& from, const Vec3<double>& direction,
                          const HeadShape& shape);

HeadGrid head_grid(const HeadShape& shape, const Eyeball& left_eye);

} // namespace rye::trainer
