// SPDX-License-Identifier: Apache-2.0
// labels_device: labels refined by a device; where there is none it says so.
#include "on_device.hpp"

#include "label_cases.hpp"

using namespace rye;
using namespace rye::test;

using Fine = DeviceDrawingPolicy<DeviceNetworks<3, 32, 32, 32>, KernelChannels<3, 8>, Balanced, 3>;

TEST_CASE("device: labels are refined as on the host") {
    labels_refined<Fine>(CudaDevice(), queue());
}
TEST_CASE("device: labels of an avatar that is not finite are refused") {
    labels_refused<Fine>(CudaDevice(), queue());
}

int main(int argc, char** argv) { return cases_on_device("labels_device", argc, argv); }
