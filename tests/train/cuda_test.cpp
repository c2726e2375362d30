// SPDX-License-Identifier: Apache-2.0
// The image terms of a training step on a device, run by its emulation on the host.
#include "../cuda/emulated.hpp"
#include "../cuda/objective_cases.hpp"

using namespace rye;
using namespace rye::test;

TEST_CASE("cuda, emulated: the image terms of a step are the host's") {
    const EmulatedDevice device;
    image_losses_against_host(device, host_queue, {});
    image_losses_against_host(device, host_queue, {.eyes_high = false, .dssim = 0.4});
    image_losses_against_host(device, host_queue,
                              {.scale = true, .face_alone = 0.7});
    for (const auto order : phase_orders)
        image_losses_against_host(EmulatedDevice{order}, host_queue,
                                  {.scale = true,
                                   .face_alone = 0.7,
                                   .dssim = 0.3});
}
TEST_CASE("cuda, emulated: the random scale of a picture is the host's") {
    for (const auto order : phase_orders) resizing_against_host(EmulatedDevice{order}, host_queue);
}
