// SPDX-License-Identifier: Apache-2.0
// Stage 1 of a program with an emulated device: its networks are the host's, so that both sides
// begin stage 2 alike; device_mesh_test.cpp runs them in the emulation.
#include "device/mesh_networks.hpp"

namespace rye::trainer {

template <>
std::unique_ptr<MeshNetworks> mesh_networks<EIGEN_MAX_ALIGN_BYTES>() {
    return nullptr;
}

} // namespace rye::trainer
