// SPDX-License-Identifier: Apache-2.0
#include "corrections/centre_errors.hpp"

#include <array>

#include <rye/avatar/eye_offset.hpp>

namespace rye::trainer {
namespace {

/// Returns the sum of the lengths of the vectors minus `less`.
double sum_of_lengths(const std::vector<Vec3<double>>& all, const Vec3<double>& less) {
    double sum = 0;
    for (const Vec3<double>& v : all) sum += (v - less).norm();
    return sum;
}

Vec3<double> mean(const std::vector<Vec3<double>>& all) {
    Vec3<double> sum = Vec3<double>::Zero();
    for (const Vec3<double>& v : all) sum += v;
    return all.empty() ? sum : Vec3<double>(sum / static_cast<double>(all.size()));
}

} // namespace

nlohmann::ordered_json CentreErrors::json() const {
    if (eyes == 0) return nullptr;
    return {{"eyes", eyes},
            {"mm", with},
            {"mm_without_offset", without},
            {"motion_mm", motion_with},
            {"motion_mm_without_offset", motion_without}};
}

CentreErrors centre_errors(const TrainState& state, const Capture& capture,
                           const std::vector<int>& frames) {
    CentreErrors errors;
    const AvatarConfig& config = state.config.avatar;
    const EyeStream<float, TrainEffects>& rig = state.avatar.eyes;
    std::array<std::vector<Vec3<double>>, 2> with, without; // differences by eye [mm]
    for (const int f : frames) {
        const CaptureFrame& frame = capture.frames[static_cast<std::size_t>(f)];
        if (!frame.eyes[0].centre && !frame.eyes[1].centre) continue;
        const OpticalDrivers<float> drivers =
            optical_drivers(state, frame_drivers(capture, f, state.config.gaze_axis));
        EyeOffsetTrace<float> trace;
        const Columns<double> offset = eye_offset<float>(train_backend(), rig.offset, config,
                                                         frame_code(config, drivers), trace)
                                           .cast<double>();
        for (std::size_t e = 0; e < 2; ++e) {
            if (!frame.eyes[e].centre) continue;
            const Index eye = static_cast<Index>(e);
            const Vec3<double> rest = rig.centre.col(eye).cast<double>(),
                               here = to_canonical(frame, *frame.eyes[e].centre);
            without[e].push_back(mm_per_unit * (rest - here));
            with[e].push_back(mm_per_unit * (rest + offset.col(eye) - here));
            ++errors.eyes;
        }
    }
    if (errors.eyes == 0) return errors;
    const double share = 1.0 / errors.eyes;
    for (std::size_t e = 0; e < 2; ++e) {
        errors.with += share * sum_of_lengths(with[e], Vec3<double>::Zero());
        errors.without += share * sum_of_lengths(without[e], Vec3<double>::Zero());
        errors.motion_with += share * sum_of_lengths(with[e], mean(with[e]));
        errors.motion_without += share * sum_of_lengths(without[e], mean(without[e]));
    }
    return errors;
}

} // namespace rye::trainer
