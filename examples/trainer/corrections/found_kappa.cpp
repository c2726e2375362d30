// SPDX-License-Identifier: Apache-2.0
#include "corrections/found_kappa.hpp"

#include <cstdio>

#include <rye/io/eye_sizes.hpp>
#include <rye/rig/gaze.hpp>
#include <rye/train/capture_subject.hpp>

#include "corrections/seen_gazes.hpp"
#include "data/degrees.hpp"
#include "data/median.hpp"

namespace rye::trainer {
namespace {

/// Number of frames whose irises tell an eye's kappa.
constexpr std::size_t enough_frames = 6;

} // namespace

FoundKappa find_kappa(const Capture& capture, double radius) {
    FoundKappa found;
    if (!capture.has_eye_masks) return found;
    std::vector<int> frames;
    std::vector<std::array<EyeballInHead, 2>> balls;
    for (const int frame : capture.train) {
        const CaptureFrame& f = capture.frames[static_cast<std::size_t>(frame)];
        if (!f.eyes[0].centre || !f.eyes[1].centre) continue;
        frames.push_back(frame);
        std::array<EyeballInHead, 2>& both = balls.emplace_back();
        for (std::size_t e = 0; e < 2; ++e) {
            const EyeSizes sizes = eye_sizes(f.eyes[e], f.scale, radius);
            both[e] = {to_canonical(f, *f.eyes[e].centre), sizes.radius, sizes.limbus_radius,
                       sizes.iris_plane};
        }
    }
    const std::vector<std::array<SeenGaze, 2>> seen = seen_gazes(capture, frames, balls);
    for (std::size_t e = 0; e < 2; ++e) {
        std::array<std::vector<double>, 2> off;
        for (std::size_t i = 0; i < frames.size(); ++i) {
            const CaptureEye& eye = capture.frames[static_cast<std::size_t>(frames[i])].eyes[e];
            if (seen[i][e].views == 0 || !eye.visual) continue;
            const Vec2<double> d = seen[i][e].angles - pitch_yaw(*eye.visual);
            for (const std::size_t k : {0U, 1U}) off[k].push_back(d[static_cast<Index>(k)]);
        }
        found.frames[e] = static_cast<int>(off[0].size());
        if (off[0].size() >= enough_frames) found.angles[e] = {median(off[0]), median(off[1])};
    }
    return found;
}

std::vector<std::string> FoundKappa::lines() const {
    std::vector<std::string> all;
    for (std::size_t e = 0; e < 2; ++e) {
        const char* const side = e == 0 ? "left" : "right";
        char text[160];
        if (static_cast<std::size_t>(frames[e]) < enough_frames)
            std::snprintf(text, sizeof text, "kappa, %s: not found, as %d frames show the iris",
                          side, frames[e]);
        else
            std::snprintf(text, sizeof text,
                          "kappa, %s: %+.1f degrees to the subject's left, %+.1f up, by %d irises",
                          side, degrees * angles[e][1], degrees * angles[e][0], frames[e]);
        all.emplace_back(text);
    }
    return all;
}

} // namespace rye::trainer
