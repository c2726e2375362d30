// SPDX-License-Identifier: Apache-2.0
/// synthetic_capture/makehuman_shapes.hpp: what identity and expressions do to MakeHuman's base
/// mesh: displacements of its vertices (3 x V) [dm], by name.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "synthetic_capture/makehuman_source.hpp"

namespace rye::trainer::makehuman {

using Named = std::vector<std::pair<std::string, Points>>;

/// Returns the mean over the kinds of people, at an age: "young" or "old".
Points mean_kind(const Source& source, const std::string& age);

/// Returns the modes of identity; `mean` is of young people. They move the eyes in the frame.
Named identity_modes(const Source& source, const Points& mean);

/// Returns the expressions and what lids do that follow the gaze, in the order of their names.
Named expression_shapes(const Source& source);

} // namespace rye::trainer::makehuman
