// SPDX-License-Identifier: Apache-2.0
#include "importers/iris_size.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include <rye/train/capture_subject.hpp>

#include "corrections/seen_gazes.hpp"
#include "data/config.hpp"

namespace rye::trainer {
namespace {

/// Returns the radius of the rim of the iris, over the distance of its plane, that explains the
/// pictures of the eyes best; 0 if none from 0.36 to 0.72 does, or none are seen. balls: both eyes
/// in each of these frames.
double rim_of_iris(const Capture& capture, const std::vector<int>& frames,
                   const std::vector<std::array<EyeballInHead, 2>>& balls) {
    constexpr int count = 7;
    constexpr double least = 0.36, step = 0.06;
    std::array<double, count> explained{};
    for (int i = 0; i < count; ++i) {
        std::vector<std::array<EyeballInHead, 2>> changed = balls;
        for (std::array<EyeballInHead, 2>& both : changed)
            for (EyeballInHead& ball : both)
                ball.limbus_radius = (least + i * step) * ball.iris_plane;
        for (const auto& both : seen_irises(capture, frames, changed))
            for (const std::vector<SeenIris>& irises : both)
                for (const SeenIris& s : irises)
                    explained[static_cast<std::size_t>(i)] += s.sharpness * s.contrast;
    }
    const auto most = std::max_element(explained.begin(), explained.end());
    const auto i = most - explained.begin();
    if (*most <= 0 || i == 0 || i + 1 == count) return 0;
    double between = 0; // of a parabola through the neighbours
    const double a = *(most - 1), b = *most, c = *(most + 1), bend = a - 2 * b + c;
    if (bend < 0) between = 0.5 * (a - c) / bend;
    return least + (static_cast<double>(i) + between) * step;
}

} // namespace

double measure_iris(Capture& capture) {
    double rim = 0;
    constexpr int rounds = 2;
    for (int round = 0; round < rounds; ++round) {
        std::vector<std::array<EyeballInHead, 2>> balls;
        for (const int i : capture.train) {
            const CaptureFrame& f = capture.frames[static_cast<std::size_t>(i)];
            balls.emplace_back();
            for (std::size_t e = 0; e < 2; ++e) {
                const EyeSizes s = eye_sizes(f.eyes[e], f.scale, EyeballConfig{}.radius);
                balls.back()[e] = {to_canonical(f, *f.eyes[e].centre), s.radius, s.limbus_radius,
                                   s.iris_plane};
            }
        }
        const double found = rim_of_iris(capture, capture.train, balls);
        if (found <= 0) break;
        rim = found;
        // The rim lies on the eyeball.
        const double plane = 1 / std::hypot(1, rim);
        for (CaptureFrame& f : capture.frames)
            for (CaptureEye& eye : f.eyes) {
                eye.iris_plane = plane * *eye.radius;
                eye.limbus_radius = rim * plane * *eye.radius;
            }
    }
    return rim / std::hypot(1, rim);
}

} // namespace rye::trainer
