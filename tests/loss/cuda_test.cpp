// SPDX-License-Identifier: Apache-2.0
// The losses' kernels of a device, run by its emulation on the host.
#include "../cuda/emulated.hpp"
#include "../cuda/image_loss_cases.hpp"
#include "../cuda/lpips_cases.hpp"

using namespace rye;
using namespace rye::test;

TEST_CASE("cuda, emulated: D-SSIM is the host's") {
    for (const auto order : phase_orders) dssim_against_host(EmulatedDevice{order}, host_queue);
}
TEST_CASE("cuda, emulated: the pyramid of differences is the host's") {
    for (const auto order : phase_orders) pyramid_against_host(EmulatedDevice{order}, host_queue);
}
TEST_CASE("cuda, emulated: the smoothness prior is the host's") {
    for (const auto order : phase_orders)
        smoothness_against_host(EmulatedDevice{order}, host_queue);
}
TEST_CASE("cuda, emulated: the perceptual distance is the host's, of a picture and of a crop") {
    lpips_against_host<3>(EmulatedDevice{}, host_queue, {19, 17, 19, 17, {0, 0}, 1e-5});
    lpips_against_host<2>(EmulatedDevice{}, host_queue, {22, 20, 17, 16, {3, 4}, 1e-3});
    for (const auto order : phase_orders)
        lpips_against_host<1>(EmulatedDevice{order}, host_queue, {17, 16, 16, 16, {1, 0}, 0.3});
}
TEST_CASE("cuda, emulated: the report names a term that is not finite") {
    report_of_bad_terms(EmulatedDevice{}, host_queue);
}
