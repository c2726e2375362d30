// SPDX-License-Identifier: Apache-2.0
// Pictures of an avatar by a device, run by its emulation on the host.
#include "../cuda/drawer_cases.hpp"
#include "../cuda/emulated.hpp"
#include "../cuda/kept_work.hpp"

using namespace rye;
using namespace rye::test;

TEST_CASE("cuda, emulated: pictures of an avatar and of its parts are the host's") {
    variants_drawn(EmulatedDevice{}, host_queue, 2e-5);
}
TEST_CASE("cuda, emulated: pictures of other sizes of super-resolution are the host's") {
    sizes_drawn(EmulatedDevice{PhaseOrder::shuffled}, host_queue, 2e-5);
}
TEST_CASE("cuda, emulated: a drawer redoes what differs from the frame before") {
    drawer_by_difference(EmulatedDevice{}, host_queue);
}
TEST_CASE("cuda, emulated: a drawer's two views of one driving are each alone") {
    two_views_drawn(EmulatedDevice{}, host_queue);
}
TEST_CASE("cuda, emulated: what a drawer refuses") {
    drawer_bad_input(EmulatedDevice{}, host_queue);
}
TEST_CASE("cuda, emulated: frames that are kept have the bits of single launches") {
    static MemoryOfKeptWork memory;
    DeviceOfKeptWork::launches = 0;
    const EmulatedDevice plain{PhaseOrder::shuffled};
    CHECK(kept_frames_drawn(DeviceOfKeptWork{plain}, plain, {nullptr, memory}) == 4);
    CHECK(DeviceOfKeptWork::launches > 12);
    CHECK(kept_frames_drawn(plain, plain, host_queue) == 0);
    kept_frames_without_gaze(DeviceOfKeptWork{plain}, plain, {nullptr, memory});
}
