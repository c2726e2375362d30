// SPDX-License-Identifier: Apache-2.0
// Layers of images on a device, run by its emulation on the host.
#include "../cuda/convolution_cases.hpp"
#include "../cuda/emulated.hpp"
#include "../cuda/upsampler_cases.hpp"

using namespace rye;
using namespace rye::test;

TEST_CASE("cuda, emulated: convolutions are the host's") {
    for (const auto order : phase_orders)
        convolution_against_host<1>(EmulatedDevice{order}, host_queue, {19, 17, 33, 5, 4e-3, 4});
    const EmulatedDevice device;
    convolution_against_host<1>(device, host_queue, {17, 9, 8, 70, 4e-3});
    convolution_against_host<1>(device, host_queue, {35, 18, 40, 66, 4e-3, 2});
    convolution_against_host<1>(device, host_queue, {9, 34, 20, 7, 4e-3, 1});
    convolution_against_host<2>(device, host_queue, {19, 18, 34, 9, 1e-5});
    convolution_against_host<2>(device, host_queue, {5, 33, 3, 40, 1e-5, 4});
    convolution_against_host<3>(device, host_queue, {19, 18, 34, 9, 1e-6});
    convolution_against_host<3>(device, host_queue, {1, 1, 1, 1, 1e-6});
}
TEST_CASE("cuda, emulated: convolutions that do not fit") {
    convolution_faults(EmulatedDevice{}, host_queue);
}
TEST_CASE("cuda, emulated: super-resolution is the host's") {
    const EmulatedDevice device;
    constexpr auto none = Normalization::none;
    upsampler_against_host<3>(device, host_queue, {{5, 3, 2}, 7, 5, 1e-5, 1e-5});
    upsampler_against_host<3>(device, host_queue, {{5, 6, 1, none}, 9, 8, 1e-5, 1e-5});
    upsampler_against_host<3>(device, host_queue, {{4, 5, 0}, 18, 7, 1e-5, 1e-5});
    upsampler_against_host<3>(device, host_queue,
                              {{6, 3, 2, Normalization::instance, true}, 6, 7, 1e-5, 1e-5});
    upsampler_against_host<3>(device, host_queue, {{4, 5, 0, none, true}, 9, 8, 1e-5, 1e-5});
    upsampler_against_host<2>(device, host_queue, {{5, 6, 1}, 9, 8, 2e-5, 1e-3});
    for (const auto order : phase_orders)
        upsampler_against_host<1>(EmulatedDevice{order}, host_queue,
                                  {{5, 6, 1, Normalization::instance, true}, 9, 8, 2e-2, 0.3});
}
TEST_CASE("cuda, emulated: super-resolution that does not fit") {
    upsampler_faults(EmulatedDevice{}, host_queue);
}
