// SPDX-License-Identifier: Apache-2.0
// drawer_device: pictures of avatars on a device against the host's; where there is none it says
// so.
#include "on_device.hpp"

#include "drawer_cases.hpp"

using namespace rye;
using namespace rye::test;

TEST_CASE("device: pictures of an avatar and of its parts are the host's") {
    variants_drawn(CudaDevice(), queue(), 1e-4);
}
TEST_CASE("device: pictures of other sizes of super-resolution are the host's") {
    sizes_drawn(CudaDevice(), queue(), 1e-4);
}
TEST_CASE("device: a drawer redoes what differs from the frame before") {
    drawer_by_difference(CudaDevice(), queue());
}
TEST_CASE("device: a drawer's two views of one driving are each alone") {
    two_views_drawn(CudaDevice(), queue());
}
TEST_CASE("device: frames that are kept have the bits of single launches") {
    CHECK(kept_frames_drawn(CudaDevice(), CudaDevice(), queue()) == 4);
    kept_frames_without_gaze(CudaDevice(), CudaDevice(), queue());
}
TEST_CASE("device: what a drawer refuses") { drawer_bad_input(CudaDevice(), queue()); }

int main(int argc, char** argv) { return cases_on_device("drawer_device", argc, argv); }
