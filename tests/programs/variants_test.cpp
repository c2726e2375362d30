// SPDX-License-Identifier: Apache-2.0
#include "drawing/variants.hpp"

#include <doctest/doctest.h>

#include "tiny_run.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

std::vector<DrawnFrame> frames(int count) {
    return std::vector<DrawnFrame>(static_cast<std::size_t>(count),
                                   {test::tiny_drivers<float>(),
                                    test::tiny_camera(64, 48).cast<float>()});
}

/// Frames in which one driver changes: the variant used, and its difference from all effects.
template <class Change>
void check(const TrainState& state, const std::string& variant, const Change& change) {
    std::vector<DrawnFrame> shown = frames(4);
    for (std::size_t k = 0; k < shown.size(); ++k) change(shown[k], static_cast<float>(k));
    const FrameDrawer drawer(state, shown, "", "--effects", 1.0 / 255);
    INFO(drawer.explanation());
    CHECK(drawer.variant() == variant);
    CHECK(drawer.explanation().find("NOT drawn") == std::string::npos);
    float moved = 0;
    for (const DrawnFrame& f : shown) {
        const Image<float> all = drawer.picture_by_all(f);
        CHECK((all.pixels - drawer.picture(f).pixels).cwiseAbs().maxCoeff() <= 1.0f / 255);
        moved = std::max(moved, (all.pixels - drawer.picture_by_all(shown[0]).pixels)
                                    .cwiseAbs().maxCoeff());
    }
    CHECK(moved > 0.02f);  // the change is visible
}

} // namespace

TEST_CASE("variants: the smallest that has what changes draws the same pictures") {
    const TrainState state = tiny_state();
    check(state, "still", [](DrawnFrame& f, float k) { f.camera.cx += 3 * k; });
    check(state, "gaze", [](DrawnFrame& f, float k) {
        f.drivers.gaze[0] = Vec3<float>(0.1f * k, 0.1f, 1).normalized();
    });
    check(state, "gaze", [](DrawnFrame& f, float k) {
        f.drivers.gaze = {Vec3<float>(0.1f * k, 0.1f, 1).normalized(),
                          Vec3<float>(0.3f, -0.1f * k, 1).normalized()};
    });
    check(state, "talk", [](DrawnFrame& f, float k) {
        f.drivers.expression[1] += 0.5f * k;
        f.drivers.gaze[1] = Vec3<float>(0.1f * k, 0.1f, 1).normalized();
    });
    check(state, "paper", [](DrawnFrame& f, float k) { f.drivers.pose[1] += 0.2f * k; });
}

TEST_CASE("variants: one picture is drawn by all, and so is what the user asks for") {
    const TrainState state = tiny_state();
    const auto drawn = [&](const std::string& wanted, int count) {
        std::vector<DrawnFrame> shown = frames(count);
        if (count > 1) shown[1].drivers.gaze[0] = Vec3<float>::UnitZ();
        return FrameDrawer(state, shown, wanted, "--effects", 1.0 / 255);
    };
    CHECK(drawn("", 1).variant() == "paper");
    CHECK(drawn("auto", 2).variant() == "gaze");
    CHECK(drawn("paper", 2).variant() == "paper");
    CHECK(drawn("still", 1).variant() == "still");
    CHECK(drawn("none", 1).variant() == "still");
    CHECK(drawn("left-gaze,head_pose", 2).variant() == "gaze");
    CHECK(drawn("expression", 2).variant() == "talk");
    const FrameDrawer still = drawn("still", 2);
    CHECK(still.explanation().find("NOT drawn    left gaze") != std::string::npos);
    const std::vector<DrawnFrame> shown = frames(1);
    const DrawnFrame& f = shown.front();
    CHECK((drawn("paper", 1).picture(f).pixels == drawn("", 1).picture_by_all(f).pixels));
}

TEST_CASE("variants: an effect that there is not is named") {
    const TrainState state = tiny_state();
    const auto message = [&](const std::string& wanted) -> std::string {
        try {
            FrameDrawer(state, frames(2), wanted, "--effects", 1.0 / 255);
        } catch (const Error& e) {
            return e.what();
        }
        return "accepted";
    };
    CHECK(message("left gaze, smile").starts_with(
        "--effects (one of the variants paper, talk, gaze, still, or names of effects): got "
        "'smile', expected names of effects: expression, head pose,"));
    CHECK(message("left gaze,").find("got ''") != std::string::npos);
    CHECK(message("corneal refraction, left gaze") == "accepted");
}
