// SPDX-License-Identifier: Apache-2.0
/// benchmarks/cuda/rates.hpp: what this device can do a second of what kernels ask it for,
/// measured. Under nvcc only.
#pragma once

#include <cstddef>
#include <cstdint>

#include <rye/backend/cuda/device.hpp>

namespace rye::bench {

inline constexpr int rounds = 512, blocks = 1056, threads = 256;

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

/// Time of a call on the default stream, mean of 10 after 3.
template <class F>
float milliseconds(const F& f) {
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

/// Warp instructions a second. `out`: memory for a number a thread.
template <Work work>
double instructions(float* out) {
    const float ms = milliseconds([&] { run<work><<<blocks, threads>>>(out); });
    return double(blocks) * threads / 32 * rounds * 4 / double(ms) * 1e3;
}

inline constexpr std::size_t copied_memory = std::size_t(1) << 30U; ///< [bytes]

/// Bytes read and written a second where memory is copied. `memory`: copied_memory of it.
inline double copied_bytes(float* memory) {
    const std::size_t bytes = copied_memory / 2;
    const float ms = milliseconds([&] {
        check_cuda(cudaMemcpyAsync(memory, memory + bytes / 4, bytes, cudaMemcpyDeviceToDevice),
                   "copy");
    });
    return 2 * double(bytes) / double(ms) * 1e3;
}

} // namespace rye::bench
