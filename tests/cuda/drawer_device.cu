// SPDX-License-Identifier: Apache-2.0
// drawer_device: pictures of avatars on a device against the host's; where there is none it says
// so.
#define DOCTEST_CONFIG_IMPLEMENT
#include "drawer_cases.hpp"

#include <rye/backend/cuda/device.hpp>

#include <cstdio>

using namespace rye;
using namespace rye::test;

namespace {

StreamMemory memory;
cudaStream_t stream;
const CudaQueue& queue() {
    static const CudaQueue q{stream, memory};
    return q;
}

} // namespace

TEST_CASE("device: pictures of an avatar and of its parts are the host's") {
    variants_drawn(CudaDevice(), queue(), 1e-4);
}
TEST_CASE("device: pictures of other sizes of super-resolution are the host's") {
    sizes_drawn(CudaDevice(), queue(), 1e-4);
}
TEST_CASE("device: what a drawer refuses") { drawer_bad_input(CudaDevice(), queue()); }

int main(int argc, char** argv) {
    int devices = 0;
    if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
        std::puts("drawer_device: skipped, no device is there");
        return 77;
    }
    check_cuda(cudaStreamCreate(&stream), "test");
    return doctest::Context(argc, argv).run();
}
