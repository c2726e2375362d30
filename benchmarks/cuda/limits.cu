// SPDX-License-Identifier: Apache-2.0
// limits: what this device can do of what the kernels ask it for: copies, fused products, 2^x,
// shuffles, transposes and products of matrices, counters in device memory.
#include <rye/backend/cuda/device.hpp>

#include <cstdio>

#include "rates.hpp"

namespace {

using namespace rye;
using namespace rye::bench;

__global__ void count(std::uint32_t* counters, std::uint32_t spread, std::uint32_t apart) {
    std::uint32_t x = (blockIdx.x * threads + threadIdx.x) * 2654435761U;
    for (int k = 0; k < 64; ++k) {
        x = x * 1664525U + 1013904223U;
        atomicAdd(counters + (x >> 8U) % spread * apart, 1U);
    }
}

} // namespace

int main() {
    int devices = 0;
    if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
        std::puts("cuda_limits: skipped, no device is there");
        return 0;
    }
    try {
        cudaDeviceProp p{};
        check_cuda(cudaGetDeviceProperties(&p, 0), "device");
        std::printf("%s, %d SMs\n", p.name, p.multiProcessorCount);
        float* out = nullptr;
        check_cuda(cudaMalloc(&out, copied_memory), "memory");
        std::printf("copy, read and write   %7.2f TB/s\n", copied_bytes(out) * 1e-12);
        const auto rate = [&](const char* what, double of_warps) {
            std::printf("%-22s %7.1f G warp instructions/s\n", what, of_warps * 1e-9);
        };
        rate("fused products", instructions<Work::fma>(out));
        rate("2^x", instructions<Work::exp2>(out));
        rate("shuffles", instructions<Work::shuffle>(out));
        rate("transposes of 8 x 8", instructions<Work::transpose>(out));
        rate("products 16 x 8 x 16", instructions<Work::product>(out));
        auto* const counters = reinterpret_cast<std::uint32_t*>(out);
        for (const std::uint32_t spread : {1024U, 8192U})
            for (const std::uint32_t apart : {1U, 8U}) {
                const float ms =
                    milliseconds([&] { count<<<blocks, threads>>>(counters, spread, apart); });
                std::printf("counters, %4u, %2u bytes apart %5.1f G/s\n", spread, 4 * apart,
                            double(blocks) * threads * 64 / ms * 1e-6);
            }
        check_cuda(cudaDeviceSynchronize(), "limits");
    } catch (const std::exception& e) {
        std::printf("failed: %s\n", e.what());
        return 1;
    }
    return 0;
}
