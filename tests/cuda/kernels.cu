// SPDX-License-Identifier: Apache-2.0
// The kernels whose machine code is counted (machine_code.sh): rules of Fast, features and alpha
// alone, 3 and 32 channels; networks of width 256 by one plane of bf16.
#include <rye/backend/cuda/device.hpp>
#include <rye/nn/cuda/mlp.hpp>
#include <rye/splat/cuda/sh_color.hpp>

using namespace rye;
using Rules = FeaturesOnly<Fast>;
using Tiles = MlpTiles<1, 256, 128>;

template <class K>
const void* kernel() {
    return reinterpret_cast<const void*>(detail::run_kernel<K>);
}
const void* const kernels[] = {kernel<ProjectKernel<Rules, NoDistortion>>(),
                               kernel<ScanKernel>(),
                               kernel<BinKernel<Rules>>(),
                               kernel<BlendKernel<Rules, 3>>(),
                               kernel<BlendKernel<Rules, 32>>(),
                               kernel<ReverseKernel<Rules, 3, false>>(),
                               kernel<ReverseKernel<Rules, 32, false>>(),
                               kernel<MergeKernel<Rules, NoDistortion, 3>>(),
                               kernel<MergeKernel<Rules, NoDistortion, 32>>(),
                               kernel<ShColorKernel<3>>(),
                               kernel<ShColorVjpKernel<3>>(),
                               kernel<MlpForwardKernel<Tiles, LeakyRelu>>(),
                               kernel<MlpReverseKernel<Tiles, LeakyRelu>>(),
                               kernel<MlpWeightKernel<1>>()};
