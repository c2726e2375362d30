// SPDX-License-Identifier: Apache-2.0
// Lesson 8: a device. Gaussians in device memory are drawn on the program's own stream, from its
// buffers, into its image, and differentiated there. Nothing is copied on the way.
#include <rye/backend/cuda/device.hpp>
#include <rye/splat/cuda/rasterizer.hpp>

#include <cstdio>
#include <vector>

namespace {

// The program's own memory: rye has none.
float* device_array(const std::vector<float>& x) {
    float* p = nullptr;
    rye::check_cuda(cudaMalloc(&p, x.size() * sizeof(float)), "lesson");
    rye::check_cuda(cudaMemcpy(p, x.data(), x.size() * sizeof(float), cudaMemcpyHostToDevice),
                    "lesson");
    return p;
}

} // namespace

int main() {
    int devices = 0;
    if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
        std::puts("skipped: no device is there");
        return 0;
    }
    cudaStream_t stream;
    rye::check_cuda(cudaStreamCreate(&stream), "lesson");
    rye::StreamMemory memory; // or any type with allocate and release
    const rye::CudaQueue queue{stream, memory};

    // Two Gaussians: a red one before a large blue one. A column a Gaussian.
    const rye::Index n = 2, size = 64, pixels = size * size;
    float* const mean = device_array({0, 0, 2, 0.1F, 0, 3});
    float* const rotation = device_array({1, 0, 0, 0, 1, 0, 0, 0});
    float* const scale = device_array({0.2F, 0.1F, 0.1F, 0.8F, 0.8F, 0.8F});
    float* const opacity = device_array({0.8F, 0.6F});
    float* const colour = device_array({1, 0, 0, 0, 0, 1});
    float* const background = device_array({0, 0, 0});
    const rye::DeviceGaussians<const float> gaussians{
        {mean, 3, n}, {rotation, 4, n}, {scale, 3, n}, {opacity, 1, n}, {colour, 3, n}};
    const rye::Pinhole<float> camera{80, 80, 32, 32, int(size), int(size)};

    // The images are the program's as well.
    float* const image = device_array(std::vector<float>(3 * pixels));
    float* const alpha = device_array(std::vector<float>(pixels));
    const rye::DeviceImages images{{image, 3, pixels}, {alpha, 1, pixels}};

    const rye::DeviceRasterizer<rye::FeaturesOnly<rye::Fast>, rye::CudaDevice,
                                rye::KernelChannels<3>>
        rasterizer;
    rye::DeviceFrame<rye::CudaDevice> frame;
    do rasterizer.forward_into(queue, gaussians, camera, background, images, frame);
    while (!frame.finish(queue)); // waits, and makes room where there was too little

    // Back: how the red of the whole picture changes with every number of the Gaussians.
    std::vector<float> red(3 * pixels);
    for (rye::Index p = 0; p < pixels; ++p) red[3 * p] = 1;
    const float* const cotangent = device_array(red);
    const std::vector<float> zeros(4 * n);
    float* const g_opacity = device_array(zeros);
    const rye::DeviceGaussians<float> gradient{{device_array(zeros), 3, n},
                                               {device_array(zeros), 4, n},
                                               {device_array(zeros), 3, n},
                                               {g_opacity, 1, n},
                                               {device_array(zeros), 3, n}};
    rasterizer.vjp_into(queue, gaussians, camera, background, {{cotangent, 3, pixels}}, gradient,
                        frame);

    float centre[3], d_opacity[2];
    frame.device.fetch(queue, centre, image + 3 * (32 * size + 32), sizeof centre);
    frame.device.fetch(queue, d_opacity, g_opacity, sizeof d_opacity);
    std::printf("middle of the picture: red %.3f, green %.3f, blue %.3f\n", centre[0], centre[1],
                centre[2]);
    std::printf("d red / d opacity: of the red one %.1f, of the blue one behind it %.1f\n",
                d_opacity[0], d_opacity[1]);
    return centre[0] > centre[2] && d_opacity[0] > 0 ? 0 : 1;
}
