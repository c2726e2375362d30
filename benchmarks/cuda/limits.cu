// SPDX-License-Identifier: Apache-2.0
// limits: what this device can do of what the kernels ask it for: copies, fused products, 2^x,
// shuffles, transposes and products of matrices, counters in device memory.
#include <rye/backend/cuda/device.hpp>

#include <cstdio>
#include <functional>
#include <string>

namespace {

using namespace rye;

constexpr int rounds = 512, blocks = 1056, threads = 256;

enum class Work { fma, exp2, shuffle, transpose, product };

template <Work work>
__global__ void run(float* out) {
    float a = static_cast<float>(threadIdx.x), b = a + 1, c = b + 1, d = c + 1;
    std::uint32_t u = threadIdx.x, v = u + 1, w = v + 1, x = w + 1;
    Array<float, 4> sum{{a, b, c, d}};
    for (int k = 0; k < rounds; ++k) {
        if constexpr (work == Work::fma) {
            a = DeviceWarp::fma(a, 0.999F, 1.0F), b = DeviceWarp::fma(b, 0.999F, 1.0F);
            c = DeviceWarp::fma(c, 0.999F, 1.0F), d = DeviceWarp::fma(d, 0.999F, 1.0F);
        } else if constexpr (work == Work::exp2) {
            a = DeviceWarp::exp2(a), b = DeviceWarp::exp2(b);
            c = DeviceWarp::exp2(c), d = DeviceWarp::exp2(d);
        } else if constexpr (work == Work::shuffle) {
            a = DeviceWarp::across<1>(a), b = DeviceWarp::across<2>(b);
            c = DeviceWarp::across<4>(c), d = DeviceWarp::across<8>(d);
        } else if constexpr (work == Work::transpose) {
            u = DeviceWarp::transpose(u), v = DeviceWarp::transpose(v);
            w = DeviceWarp::transpose(w), x = DeviceWarp::transpose(x);
        } else {
            for (int i = 0; i < 4; ++i) DeviceWarp::mma(sum, {{u, v, w, x}}, {{v, w}});
        }
    }
    out[blockIdx.x * threads + threadIdx.x] =
        a + b + c + d + sum[0] + static_cast<float>(u + v + w + x);
}

__global__ void count(std::uint32_t* counters, std::uint32_t spread, std::uint32_t apart) {
    std::uint32_t x = (blockIdx.x * threads + threadIdx.x) * 2654435761U;
    for (int k = 0; k < 64; ++k) {
        x = x * 1664525U + 1013904223U;
        atomicAdd(counters + (x >> 8U) % spread * apart, 1U);
    }
}

float milliseconds(const std::function<void()>& f) {
    cudaEvent_t begin, end;
    check_cuda(cudaEventCreate(&begin), "event");
    check_cuda(cudaEventCreate(&end), "event");
    for (int k = 0; k < 3; ++k) f();
    check_cuda(cudaEventRecord(begin), "event");
    for (int k = 0; k < 10; ++k) f();
    check_cuda(cudaEventRecord(end), "event");
    check_cuda(cudaEventSynchronize(end), "event");
    float ms = 0;
    check_cuda(cudaEventElapsedTime(&ms, begin, end), "event");
    return ms / 10;
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
        const std::size_t bytes = std::size_t(1) << 29U;
        check_cuda(cudaMalloc(&out, 2 * bytes), "memory");
        const float copy = milliseconds([&] {
            check_cuda(cudaMemcpyAsync(out, out + bytes / 4, bytes, cudaMemcpyDeviceToDevice),
                       "copy");
        });
        std::printf("copy, read and write   %7.2f TB/s\n", 2 * double(bytes) / copy * 1e-9);
        const double warps = double(blocks) * threads / 32 * rounds * 4;
        const auto rate = [&](const char* what, float ms) {
            std::printf("%-22s %7.1f G warp instructions/s\n", what, warps / ms * 1e-6);
        };
        rate("fused products", milliseconds([&] { run<Work::fma><<<blocks, threads>>>(out); }));
        rate("2^x", milliseconds([&] { run<Work::exp2><<<blocks, threads>>>(out); }));
        rate("shuffles", milliseconds([&] { run<Work::shuffle><<<blocks, threads>>>(out); }));
        rate("transposes of 8 x 8",
             milliseconds([&] { run<Work::transpose><<<blocks, threads>>>(out); }));
        rate("products 16 x 8 x 16",
             milliseconds([&] { run<Work::product><<<blocks, threads>>>(out); }));
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
