// SPDX-License-Identifier: Apache-2.0
/// tests/cuda/on_device.hpp: what test programs of a device share: the current device's stream and
/// memory, and the end where there is none. Include it first, in one unit: it holds doctest itself.
#pragma once

#define DOCTEST_CONFIG_IMPLEMENT
#include <doctest/doctest.h>

#include <cstdio>

#include <rye/backend/cuda/device.hpp>

namespace rye::test {

/// A stream of the current device, with CUDA's pool of memory.
inline const CudaQueue& queue() {
    static StreamMemory memory;
    static const CudaQueue q{[] {
                                 cudaStream_t stream;
                                 check_cuda(cudaStreamCreate(&stream), "test");
                                 return stream;
                             }(),
                             memory};
    return q;
}

/// The result of f(), or ctest's 77 and a line where no device is there.
template <class F>
int on_device(const char* program, const F& f) {
    int devices = 0;
    if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
        std::printf("%s: skipped, no device is there\n", program);
        return 77;
    }
    return f();
}
/// Runs the program's cases, with doctest's options.
inline int cases_on_device(const char* program, int argc, char** argv) {
    return on_device(program, [&] { return doctest::Context(argc, argv).run(); });
}

} // namespace rye::test
