// SPDX-License-Identifier: Apache-2.0
// Functions of device/mesh_networks.hpp in a build without kernels (RYE_CUDA=OFF).
#include "device/mesh_networks.hpp"

namespace rye::trainer {

template <>
std::unique_ptr<MeshNetworks> mesh_networks<EIGEN_MAX_ALIGN_BYTES>() {
    throw Error(
        "stage 1 on a device: this program was built without kernels, expected a build "
        "with -DRYE_CUDA=ON");
}

} // namespace rye::trainer
