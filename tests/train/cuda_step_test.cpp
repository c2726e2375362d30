// SPDX-License-Identifier: Apache-2.0
// Whole training steps on a device, run by its emulation on the host.
#include <rye/backend/cuda/emulation.hpp>

#include "../cuda/step_cases.hpp"

using namespace rye;
using namespace rye::test;

namespace {

HostMemory memory;
const CudaQueue queue{nullptr, memory};
using Fine = DeviceTrainerPolicy<DeviceNetworks<3, 32, 32, 32>, KernelChannels<3, 8>, Balanced, 3>;

} // namespace

TEST_CASE("cuda, emulated: training steps are the host's") {
    steps_against_host<Fine>(EmulatedDevice{}, queue, {});
    steps_against_host<Fine>(EmulatedDevice{PhaseOrder::shuffled}, queue,
                             {.measured = false, .scaled = false});
}
TEST_CASE("cuda, emulated: training steps give the same bits again") {
    steps_again<Fine>(EmulatedDevice{}, queue);
}
TEST_CASE("cuda, emulated: training steps make room for lists") {
    steps_make_room<Fine>(EmulatedDevice{}, queue);
}
TEST_CASE("cuda, emulated: what training steps refuse") {
    steps_refused<Fine>(EmulatedDevice{}, queue);
}
