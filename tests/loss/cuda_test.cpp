// SPDX-License-Identifier: Apache-2.0
// The losses' kernels of a device, run by its emulation on the host.
#include <rye/backend/cuda/emulation.hpp>

#include "../cuda/loss_cases.hpp"

using namespace rye;
using namespace rye::test;

TEST_CASE("cuda, emulated: the masked L1 term is the host's") {
    HostMemory memory;
    const CudaQueue queue{nullptr, memory};
    for (const auto order : {PhaseOrder::forward, PhaseOrder::backward, PhaseOrder::shuffled})
        masked_l1_against_host(EmulatedDevice{order}, queue);
}
