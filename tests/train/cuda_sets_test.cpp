// SPDX-License-Identifier: Apache-2.0
// Training steps of other sets of effects on a device, run by its emulation on the host. Each
// compiles all kernels of a step once more: check.sh --release.
#include "../cuda/emulated.hpp"
#include "../cuda/step_cases.hpp"

using namespace rye;
using namespace rye::test;

TEST_CASE("cuda, emulated: training steps of a gaze mechanism with generated features") {
    using Wide =
        DeviceTrainerPolicy<DeviceNetworks<3, 128, 64, 32>, KernelChannels<3, 8>, Balanced, 3>;
    using E = More<AllEffects, GazeBy<LearnedQuaternion>, EyesBy<RotatedFeatures>>;
    // An eye's turn sums the cotangents of all of its points, in float.
    steps_against_host<Wide, E>(EmulatedDevice{}, host_queue, {.gradient = 3e-5});
}
TEST_CASE("cuda, emulated: training steps of colours by the view, and shading") {
    using Fine =
        DeviceTrainerPolicy<DeviceNetworks<3, 32, 32, 32>, KernelChannels<3, 8>, Balanced, 3>;
    using E = More<AllEffects, HeadShading, ViewColor>;
    steps_against_host<Fine, E>(EmulatedDevice{}, host_queue, {.gradient = 3e-5});
}
