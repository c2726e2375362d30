// SPDX-License-Identifier: Apache-2.0
// networks_device: the cases of networks, layers of images, Adam and losses on a device; where
// there is none it says so.
#include "on_device.hpp"

#include "adam_cases.hpp"
#include "lpips_cases.hpp"
#include "mlp_cases.hpp"
#include "objective_cases.hpp"
#include "offload_network_cases.hpp"
#include "upsampler_cases.hpp"

#include <rye/backend/cuda/page_locked.hpp>

using namespace rye;
using namespace rye::test;

TEST_CASE("device: networks are the host's") {
    const CudaDevice device;
    const MlpShape colour{{192, 256, 256, 32}, 64}, odd{{21, 40, 33, 5}, 4},
        deformation{{91, 128, 128, 3}, 64}, narrow{{128, 128, 128, 16}, 64};
    mlp_against_host<MlpTiles<1, 256, 128>>(device, queue(), {colour, 5000, 1e-2, 0.1});
    mlp_against_host<MlpTiles<1, 128, 64>>(device, queue(), {narrow, 5000, 1e-2, 0.1});
    mlp_against_host<MlpTiles<2, 256, 128>>(device, queue(), {colour, 5000, 2e-5, 2e-4, 4e-5});
    mlp_against_host<MlpTiles<2, 256, 128>>(device, queue(), {deformation, 2001, 5e-5, 2e-4, 4e-5});
    mlp_against_host<MlpTiles<3, 256, 128>>(device, queue(), {colour, 5000, 2e-6, 1e-5, 1e-5});
    mlp_against_host<MlpTiles<2, 64, 32>>(device, queue(), {odd, 150, 2e-5, 2e-4});
    mlp_against_host<MlpTiles<3, 64, 32>>(device, queue(), {odd, 70, 1e-6, 2e-6});
    mlp_against_host<MlpTiles<2, 64, 32>>(device, queue(), {odd, 0, 2e-5, 2e-4});
}
TEST_CASE("device: networks by groups are the host's, where the build has their kernels") {
    const CudaDevice device;
    const MlpShape narrow{{128, 128, 128, 16}, 64}, wide{{192, 256, 256, 32}, 64},
        deformation{{91, 128, 128, 128, 128, 3}, 64}, odd{{47, 128, 19}, 4};
    MESSAGE("processors with such kernels: ", processors_of_groups(device));
    for (const Index n : {20001, 64, 1, 0}) {
        mlp_against_host<MlpTiles<1, 128, 64>>(device, queue(), {narrow, n, 1e-2, 0.1});
        mlp_against_host<MlpTiles<1, 128, 32>>(device, queue(), {deformation, n, 1e-2, 0.1});
        mlp_against_host<MlpTiles<1, 128, 64>>(device, queue(), {odd, n, 1e-2, 0.1});
        mlp_against_host<MlpTiles<1, 256, 128>>(device, queue(), {wide, n, 1e-2, 0.1});
    }
}
TEST_CASE("device: Adam is the host's") { adam_against_host(CudaDevice(), queue(), 1e-7); }
TEST_CASE("device: networks that do not fit") { mlp_too_wide(CudaDevice()); }
TEST_CASE("device: convolutions are the host's") {
    const CudaDevice device;
    for (const int outputs : {32, 64, 128}) {
        convolution_against_host<1>(device, queue(), {70, 33, 64, outputs, 4e-3});
        convolution_against_host<2>(device, queue(), {70, 33, 64, outputs, 1e-5});
        convolution_against_host<3>(device, queue(), {70, 33, 64, outputs, 2e-6});
    }
    convolution_against_host<2>(device, queue(), {5, 33, 3, 40, 1e-5});
    convolution_against_host<3>(device, queue(), {1, 1, 1, 1, 1e-6});
    convolution_faults(device, queue());
}
TEST_CASE("device: super-resolution is the host's") {
    const CudaDevice device;
    constexpr auto instance = Normalization::instance, none = Normalization::none;
    upsampler_against_host<3>(device, queue(), {{32, 32, 2}, 24, 20, 1e-5, 1e-5});
    upsampler_against_host<3>(device, queue(), {{5, 6, 1, none}, 9, 8, 1e-5, 1e-5});
    upsampler_against_host<3>(device, queue(), {{6, 3, 2, instance, true}, 16, 17, 1e-5, 1e-5});
    upsampler_against_host<2>(device, queue(), {{5, 6, 1}, 19, 18, 2e-5, 1e-3});
    upsampler_against_host<1>(device, queue(), {{5, 6, 1, instance, true}, 19, 18, 2e-2, 0.3});
    upsampler_faults(device, queue());
}
TEST_CASE("device: losses of images are the host's") {
    const CudaDevice device;
    dssim_against_host(device, queue());
    pyramid_against_host(device, queue());
    smoothness_against_host(device, queue());
    report_of_bad_terms(device, queue());
    lpips_against_host<3>(device, queue(), {40, 37, 33, 32, {3, 4}, 1e-5});
    resizing_against_host(device, queue());
    image_losses_against_host(device, queue(), {});
    image_losses_against_host(device, queue(),
                              {.scale = true,
                               .face_alone = 0.7,
                               .dssim = 0.3});
}
TEST_CASE("device: networks of an offload are the host's") {
    PageLockedMemory staging;
    const CudaDevice device;
    offload_against_host<MlpTiles<2, 256, 128>>(device, queue(), staging, 1e-3);
    offload_against_host<MlpTiles<3, 64, 32>>(device, queue(), staging, 1e-5);
    offload_faults(device, queue(), staging);
}

int main(int argc, char** argv) { return cases_on_device("networks_device", argc, argv); }
