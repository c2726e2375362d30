// SPDX-License-Identifier: Apache-2.0
// The losses' kernels of a device, run by its emulation on the host.
#include <rye/backend/cuda/emulation.hpp>

#include "../cuda/image_loss_cases.hpp"
#include "../cuda/lpips_cases.hpp"

using namespace rye;
using namespace rye::test;

namespace {

HostMemory memory;
const CudaQueue queue{nullptr, memory};
constexpr PhaseOrder orders[] = {PhaseOrder::forward, PhaseOrder::backward, PhaseOrder::shuffled};

} // namespace

TEST_CASE("cuda, emulated: D-SSIM is the host's") {
    for (const auto order : orders) dssim_against_host(EmulatedDevice{order}, queue);
}
TEST_CASE("cuda, emulated: the pyramid of differences is the host's") {
    for (const auto order : orders) pyramid_against_host(EmulatedDevice{order}, queue);
}
TEST_CASE("cuda, emulated: the smoothness prior is the host's") {
    for (const auto order : orders) smoothness_against_host(EmulatedDevice{order}, queue);
}
TEST_CASE("cuda, emulated: the perceptual distance is the host's, of a picture and of a crop") {
    lpips_against_host<3>(EmulatedDevice{}, queue, {19, 17, 19, 17, {0, 0}, 1e-5});
    lpips_against_host<2>(EmulatedDevice{}, queue, {22, 20, 17, 16, {3, 4}, 1e-3});
    for (const auto order : orders)
        lpips_against_host<1>(EmulatedDevice{order}, queue, {17, 16, 16, 16, {1, 0}, 0.3});
}
TEST_CASE("cuda, emulated: the report names a term that is not finite") {
    report_of_bad_terms(EmulatedDevice{}, queue);
}
