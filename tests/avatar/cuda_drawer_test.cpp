// SPDX-License-Identifier: Apache-2.0
// Pictures of an avatar by a device, run by its emulation on the host.
#include <rye/backend/cuda/emulation.hpp>

#include "../cuda/drawer_cases.hpp"

using namespace rye;
using namespace rye::test;

namespace {

HostMemory memory;
const CudaQueue queue{nullptr, memory};

} // namespace

TEST_CASE("cuda, emulated: pictures of an avatar and of its parts are the host's") {
    variants_drawn(EmulatedDevice{}, queue, 2e-5);
}
TEST_CASE("cuda, emulated: pictures of other sizes of super-resolution are the host's") {
    sizes_drawn(EmulatedDevice{PhaseOrder::shuffled}, queue, 2e-5);
}
TEST_CASE("cuda, emulated: a drawer redoes what differs from the frame before") {
    drawer_by_difference(EmulatedDevice{}, queue);
}
TEST_CASE("cuda, emulated: what a drawer refuses") { drawer_bad_input(EmulatedDevice{}, queue); }
