// SPDX-License-Identifier: Apache-2.0
/// data/fit_rigid.hpp: the rigid motion between two lists of points.
#pragma once

#include <rye/core/columns.hpp>
#include <rye/geometry/rigid.hpp>

namespace rye::trainer {

/// Returns the motion that moves `from` nearest to `to`, both 3 x N, by least squares (Kabsch 1976).
Rigid<double> fit_rigid(const Columns<double>& from, const Columns<double>& to);

/// Returns the same with a positive weight of each point's squared distance.
Rigid<double> fit_rigid(const Columns<double>& from, const Columns<double>& to,
                        const VecX<double>& weights);

} // namespace rye::trainer
