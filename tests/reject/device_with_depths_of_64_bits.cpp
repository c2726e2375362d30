// SPDX-License-Identifier: Apache-2.0
// A device sorts by depths of 32 bits.
// expect: DepthsOf32Bits
#include <rye/backend/cuda/emulation.hpp>
#include <rye/splat/cuda/rasterizer.hpp>

struct Fine : rye::Balanced {
    static constexpr int depth_bits = 64;
};
#if REJECT
using Policy = Fine;
#else
using Policy = rye::Balanced;
#endif

rye::DeviceRasterizer<Policy, rye::EmulatedDevice, rye::KernelChannels<3>> rasterizer;
