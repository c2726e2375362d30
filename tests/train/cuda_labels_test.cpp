// SPDX-License-Identifier: Apache-2.0
// Labels refined on a device, run by its emulation on the host.
#include "../cuda/emulated.hpp"
#include "../cuda/label_cases.hpp"

#include <rye/train/cuda/trainer_policy.hpp>

using namespace rye;
using namespace rye::test;

namespace {

/// The policy of the steps' cases.
using Drawn = DeviceTrainerPolicy<DeviceNetworks<3, 32, 32, 32>, KernelChannels<3, 8>, Balanced, 3>;

} // namespace

TEST_CASE("cuda, emulated: labels are refined as on the host") {
    labels_refined<Drawn>(EmulatedDevice{PhaseOrder::shuffled}, host_queue);
}
TEST_CASE("cuda, emulated: labels of an avatar that is not finite are refused") {
    labels_refused<Drawn>(EmulatedDevice{}, host_queue);
}
