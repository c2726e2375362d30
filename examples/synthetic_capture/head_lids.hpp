// SPDX-License-Identifier: Apache-2.0
/// synthetic_capture/head_lids.hpp: the eyelids of the procedural head. Closed lids are part of the
/// skin; opening slides each over the eyeball along directions from the eye's centre and stretches
/// the skin up to brow and cheek. Head frame and units of head_model.hpp.
#pragma once

#include <vector>

#include "synthetic_capture/head_grid.hpp"

namespace rye::trainer {

/// Distance of the lids' margins from the line where they meet, at their highest points [rad].
struct LidState {
    double upper = 0; ///< upwards
    double lower = 0; ///< upwards, so negative where open
};

/// Weights in [0, 1] of the motions of the lids of one eye.
struct LidDrivers {
    double blink = 0, squint = 0, wide = 0, look_up = 0, look_down = 0;
};
LidState lid_state(const LidDrivers& drivers);

/// The lids of one eye; those of the right eye are those of the left, mirrored.
class EyeLids {
  public:
    /// Selects the vertices of the closed skin that the lids move.
    EyeLids(const HeadGrid& grid, int eye, const Eyeball& left_eye, const HeadShape& shape);

    /// Weight with which a closed vertex is held in place: 1 on the eyeball, 0 from a little beyond
    /// the lids' folds on.
    double hold(const Vec3<double>& closed) const;

    /// Moves the skin in place and writes the rim to the columns from `first_rim` on. A positive
    /// `look_out` [rad] is the eye's rotation away from the nose, which shifts the upper lid's
    /// arch.
    void open(Points& vertices, const LidState& state, double look_out, Index first_rim) const;

  private:
    struct LidVertex {
        Index index;
        double azimuth, elevation, above_table;
        double part; // weight of the lids' motion
        bool upper;
    };
    double table(double azimuth, double elevation) const;
    double slide(const LidVertex& v, const LidState& state, double look_out) const;
    Vec3<double> placed(double azimuth, double elevation, double distance) const;

    double side_ = 1; // -1 for the right eye
    Eyeball eye_;
    EyeCorners corners_;
    Columns<double> table_; // distances of the closed skin, azimuth by elevation
    std::vector<LidVertex> skin_;
    std::vector<double> rim_; // azimuths
};

} // namespace rye::trainer
