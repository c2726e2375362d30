// SPDX-License-Identifier: Apache-2.0
#include "evaluation/kappa_errors.hpp"

#include "data/degrees.hpp"

namespace rye::trainer {

KappaErrors kappa_errors(const TrainState& state, const Capture& capture,
                         const std::vector<int>& frames) {
    KappaErrors errors;
    const Columns<float>& kappa = state.avatar.eyes.kappa;
    if (state.config.gaze_axis == GazeAxis::optical || kappa.size() == 0) return errors;
    for (std::size_t e = 0; e < 2; ++e) {
        Vec2<double> sum = Vec2<double>::Zero();
        double count = 0;
        for (const int frame : frames) {
            const CaptureEye& eye = capture.frames[static_cast<std::size_t>(frame)].eyes[e];
            if (!eye.kappa) continue;
            sum += *eye.kappa;
            ++count;
        }
        if (count == 0) continue;
        const Vec2<double> run = degrees * kappa.col(static_cast<Index>(e)).cast<double>();
        errors.eyes[e] = KappaPair{{run[1], run[0]}, sum / count};
    }
    return errors;
}

nlohmann::ordered_json KappaErrors::json() const {
    nlohmann::ordered_json all = nlohmann::ordered_json::object();
    for (std::size_t e = 0; e < 2; ++e)
        if (const auto& k = eyes[e])
            all[e == 0 ? "left" : "right"] = {{"yaw_pitch", {k->run[0], k->run[1]}},
                                              {"capture", {k->capture[0], k->capture[1]}},
                                              {"degrees", k->off()}};
    return all;
}

} // namespace rye::trainer
