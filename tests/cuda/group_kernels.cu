// SPDX-License-Identifier: Apache-2.0
// The kernels of sm_90a alone, whose machine code is counted (machine_code.sh): networks of the
// preset gpu and of the paper's widths, by groups.
#include <rye/backend/cuda/device.hpp>
#include <rye/nn/cuda/mlp.hpp>

using namespace rye;

template <class K>
const void* kernel() {
    return reinterpret_cast<const void*>(detail::run_kernel<K>);
}
template <int width, int inputs>
using Tiles = detail::MlpGroupTiles<MlpTiles<1, width, inputs>, LeakyRelu>;

const void* const kernels[] = {
    kernel<detail::MlpGroupForwardKernel<Tiles<128, 32>, LeakyRelu>>(),
    kernel<detail::MlpGroupForwardKernel<Tiles<128, 64>, LeakyRelu>>(),
    kernel<detail::MlpGroupForwardKernel<Tiles<256, 128>, LeakyRelu>>(),
    kernel<detail::MlpGroupReverseKernel<Tiles<128, 32>, LeakyRelu>>(),
    kernel<detail::MlpGroupReverseKernel<Tiles<128, 64>, LeakyRelu>>(),
    kernel<detail::MlpGroupReverseKernel<Tiles<256, 128>, LeakyRelu>>(),
    kernel<detail::MlpGroupForwardKernel<Tiles<256, 64>, LeakyRelu, true>>(),
    kernel<detail::MlpGroupReverseKernel<Tiles<256, 64>, LeakyRelu, true>>(),
    kernel<detail::MlpGroupWeightKernel<Tiles<128, 64>>>(),
    kernel<detail::MlpGroupWeightKernel<Tiles<256, 128>>>(),
    kernel<detail::MlpGroupWeightKernel<Tiles<256, 64>>>(),
    kernel<detail::MlpGroupMergeKernel>(),
    kernel<detail::MlpGroupPackKernel>()};
