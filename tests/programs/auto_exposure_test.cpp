// SPDX-License-Identifier: Apache-2.0
#include "data/auto_exposure.hpp"

#include <doctest/doctest.h>

using namespace rye::trainer;

namespace {

Image8 grey(int value) {
    return {4, 2, 3, std::vector<std::uint8_t>(24, static_cast<std::uint8_t>(value))};
}

} // namespace

TEST_CASE("automatic exposure: pictures like the first stay, brighter ones come back in time") {
    AutoExposure camera(10); // pictures a second
    for (int i = 0; i < 5; ++i) {
        Image8 p = grey(120);
        CHECK(camera.expose(p) == doctest::Approx(1));
        CHECK(p.values == grey(120).values);
    }
    // Twice the light: sRGB's 120 is 0.188, and 0.376 is 165.
    Image8 p = grey(165);
    const double first = camera.expose(p);
    CHECK(first < 1);
    CHECK(p.values[0] > 145); // too bright at first
    for (int i = 0; i < 20; ++i) {
        p = grey(165);
        camera.expose(p);
    }
    CHECK(p.values[0] == doctest::Approx(120).epsilon(0.01)); // after two seconds
    p = grey(165);
    CHECK(camera.expose(p) == doctest::Approx(0.5).epsilon(0.02));
    // Darkness is amplified, and no value leaves the range.
    for (int i = 0; i < 50; ++i) {
        p = grey(10);
        p.values[0] = 255;
        camera.expose(p);
    }
    CHECK(p.values[0] == 255);
    CHECK(p.values[1] > 10);
}

TEST_CASE("automatic exposure: a black picture has a gain") {
    AutoExposure camera(30);
    for (int i = 0; i < 3; ++i) {
        Image8 p = grey(0);
        CHECK(std::isfinite(camera.expose(p)));
        CHECK(p.values == grey(0).values);
    }
}
