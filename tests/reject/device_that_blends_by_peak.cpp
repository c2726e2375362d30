// SPDX-License-Identifier: Apache-2.0
// A device blends by the depths of centres.
// expect: BlendsByCentre
#include <rye/backend/cuda/emulation.hpp>
#include <rye/splat/cuda/rasterizer.hpp>

struct ByPeak : rye::Balanced {
    static constexpr rye::BlendOrder order = rye::BlendOrder::by_peak;
};
#if REJECT
using Policy = ByPeak;
#else
using Policy = rye::Balanced;
#endif

rye::DeviceRasterizer<Policy, rye::EmulatedDevice, rye::KernelChannels<3>> rasterizer;
