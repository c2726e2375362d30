// SPDX-License-Identifier: Apache-2.0
#include "evaluation/closed_lids.hpp"

#include <cmath>

#include <rye/avatar/idle_head.hpp>

namespace rye::trainer {

double ClosedLids::visible() const { return open > 0 ? closed / open : std::nan(""); }

nlohmann::ordered_json ClosedLids::json() const {
    if (pictures == 0) return nullptr;
    nlohmann::ordered_json all = {{"coefficients", names},
                                  {"pictures", pictures},
                                  {"open_pixels", open / pictures},
                                  {"closed_pixels", closed / pictures},
                                  {"visible", nullptr}};
    if (open > 0) all["visible"] = visible();
    return all;
}

ClosedLids closed_lids(const AvatarDrawer& drawer, const Capture& capture,
                       const std::vector<MeasuredView>& views, double dilation) {
    ClosedLids found;
    const auto count = static_cast<Index>(capture.expression_names.size());
    const std::vector<LidCoefficient<float>> lids =
        lid_coefficients(capture.expression_names, VecX<float>(VecX<float>::Ones(count))).blink;
    if (lids.empty()) return found;
    for (const auto& lid : lids)
        found.names.push_back(capture.expression_names[static_cast<std::size_t>(lid.index)]);
    for (const MeasuredView& v : views) {
        if (!v.pictured) continue;
        const Pinhole<float> camera = capture.camera(v.frame, v.camera).cast<float>();
        Drivers<float> drivers = frame_drivers(capture, v.frame, drawer.state().config.gaze_axis);
        const auto seen = [&](float weight) {
            for (const auto& lid : lids) drivers.expression[lid.index] = weight;
            return static_cast<double>(
                drawer.shown({drivers, camera, dilation}).eyes.area.pixels.sum());
        };
        found.open += seen(0.0f);
        found.closed += seen(1.0f);
        ++found.pictures;
    }
    return found;
}

} // namespace rye::trainer
