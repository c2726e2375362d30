// SPDX-License-Identifier: Apache-2.0
// Layers of images on a device, run by its emulation on the host.
#include <rye/backend/cuda/emulation.hpp>

#include "../cuda/convolution_cases.hpp"

using namespace rye;
using namespace rye::test;

namespace {

HostMemory memory;
const CudaQueue queue{nullptr, memory};
constexpr PhaseOrder orders[] = {PhaseOrder::forward, PhaseOrder::backward, PhaseOrder::shuffled};

} // namespace

TEST_CASE("cuda, emulated: convolutions are the host's") {
    for (const auto order : orders)
        convolution_against_host<1>(EmulatedDevice{order}, queue, {19, 17, 33, 5, 4e-3});
    const EmulatedDevice device;
    convolution_against_host<1>(device, queue, {17, 9, 8, 70, 4e-3});
    convolution_against_host<2>(device, queue, {19, 18, 34, 9, 1e-5});
    convolution_against_host<2>(device, queue, {5, 33, 3, 40, 1e-5});
    convolution_against_host<3>(device, queue, {19, 18, 34, 9, 1e-6});
    convolution_against_host<3>(device, queue, {1, 1, 1, 1, 1e-6});
}
TEST_CASE("cuda, emulated: convolutions that do not fit") {
    convolution_faults(EmulatedDevice{}, queue);
}
