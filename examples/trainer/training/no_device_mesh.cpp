// SPDX-License-Identifier: Apache-2.0
// A build without kernels for a device.
#include "training/mesh_networks.hpp"

namespace rye::trainer {

template <>
std::unique_ptr<MeshNetworks> mesh_networks<EIGEN_MAX_ALIGN_BYTES>() {
    throw Error(
        "stage 1 on a device: this program was built without kernels, expected a build "
        "with -DRYE_CUDA=ON");
}

} // namespace rye::trainer
