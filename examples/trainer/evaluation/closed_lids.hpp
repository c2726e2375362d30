// SPDX-License-Identifier: Apache-2.0
/// evaluation/closed_lids.hpp: whether the lids of an avatar close: how much of its eyeballs is
/// seen with the coefficients that close them at 1, beside the same frames with them at 0.
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "drawing/avatar_drawer.hpp"
#include "evaluation/evaluation.hpp"

namespace rye::trainer {

/// Pixels of both eyeballs in front of which no skin is, summed over pictures. A pixel that shows
/// them in part counts by that share.
struct ClosedLids {
    std::vector<std::string> names; ///< of the coefficients; empty without any
    int pictures = 0;               ///< of each kind
    double open = 0, closed = 0;    ///< [px]

    /// Returns closed / open; NaN without open eyes.
    double visible() const;
    /// Returns the fields with means a picture; null where nothing was measured.
    nlohmann::ordered_json json() const;
};

/// Draws the views of which pictures are wanted, with this dilation [px^2] and all coefficients that
/// close lids, by their names, at 0 and at 1. Measures nothing where the capture's coefficients have
/// no such names.
ClosedLids closed_lids(const AvatarDrawer& drawer, const Capture& capture,
                       const std::vector<MeasuredView>& views,
                       double dilation = trained_dilation);

} // namespace rye::trainer
