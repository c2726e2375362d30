// SPDX-License-Identifier: Apache-2.0
/// importers/iris_size.hpp: the size of the iris from the pictures of an imported capture whose
/// eyeballs are known.
#pragma once

#include "data/capture.hpp"

namespace rye::trainer {

/// Puts the size of the iris that the pictures of the training frames show best into all frames of
/// a capture with centres and radii of eyeballs. Returns the radius of its rim over that of the
/// eyeball; changes nothing and returns 0 if the pictures do not tell.
double measure_iris(Capture& capture);

} // namespace rye::trainer
