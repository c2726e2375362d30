// SPDX-License-Identifier: Apache-2.0
// With RYE_DATA set to a folder that holds capture_a and capture_a512, the gaze estimator looks at
// photographs of training frames.
#include "photographs.hpp"

#include <array>

#include <doctest/doctest.h>

#include "../support/real_data.hpp"

using namespace rye;
using namespace rye::test;
using namespace rye::trainer;

namespace {

/// Each eighth training frame.
std::vector<int> some_frames(const Capture& capture) {
    std::vector<int> frames;
    for (std::size_t k = 0; k < capture.train.size(); k += 8) frames.push_back(capture.train[k]);
    return frames;
}

/// Bounds of a summary: share of the eyes without an iris found, median and mean [deg].
struct Bounds {
    double missed, median, mean;
};

void check_photographs(const char* name, double scale, const Bounds& exact, const Bounds& high) {
    const auto folder = real_data(name);
    if (!folder) return;
    const Capture capture = read_capture(*folder);
    const std::vector<int> frames = some_frames(capture);
    const auto check = [&](const Bounds& bounds, const EyesOf& eyes_of) {
        const GazeSummary s = summary(gaze_of_photographs(capture, frames, scale, eyes_of));
        MESSAGE(std::string(name) << " x " << scale << ": missed " << s.missed << " of " << s.eyes
                                  << ", median " << s.median << ", mean " << s.mean << " degrees");
        CHECK(s.eyes > 40);
        CHECK(s.missed <= bounds.missed * s.eyes);
        CHECK(s.median <= bounds.median);
        CHECK(s.mean <= bounds.mean);
    };
    check(exact, [&](int f, int c) { return labelled_eyes(capture, f, c); });
    check(high, [&](int f, int c) { return raised_eyes(capture, f, c, 0.15); });
}

} // namespace

TEST_CASE("gaze of photographs: 256 pixels") {
    check_photographs("capture_a", 1, {0, 1.5, 2}, {0, 2, 2.6});
}

TEST_CASE("gaze of photographs: 512 pixels") {
    check_photographs("capture_a512", 1, {0, 1.5, 2}, {0, 2, 2.6});
}

TEST_CASE("gaze of photographs: 384 pixels, of larger and of smaller photographs") {
    check_photographs("capture_a", 1.5, {0, 1.5, 2.5}, {0, 2.2, 3});
    check_photographs("capture_a512", 0.75, {0, 1.5, 2.1}, {0, 2, 2.5});
}
