// SPDX-License-Identifier: Apache-2.0
// Kernels of driven features, refraction, highlights, shadows of lids, shading and colours by the
// view, run by a device's emulation on the host.
#include "../cuda/avatar_cases.hpp"
#include "../cuda/emulated.hpp"

using namespace rye;
using namespace rye::test;

namespace {

/// With room for the networks of parts.
using Wide = DeviceNetworks<3, 128, 64, 64>;

} // namespace

TEST_CASE("cuda, emulated: driven features, highlights and shading are the host's") {
    AvatarCase<LitEffects> c = case_with_parts<LitEffects>();
    c.column = 1;
    avatar_against_host<Wide>(EmulatedDevice{PhaseOrder::shuffled}, host_queue, c);
    avatar_again<Wide>(EmulatedDevice{}, host_queue, c);
    avatar_against_host<Wide>(EmulatedDevice{}, host_queue, with_corrections(c));
    for (const int degree : {1, 2}) {
        set_tiny_view_colors(c.avatar, degree);
        avatar_against_host<Wide>(EmulatedDevice{}, host_queue, c);
    }
    c.avatar.view_color = {};
    avatar_against_host<Wide>(EmulatedDevice{}, host_queue, c);
    c.avatar.shading = {};
    c.avatar.eyes.networks[0] = {};
    avatar_against_host<Wide>(EmulatedDevice{}, host_queue, c);
    c.avatar.eyes.networks[1] = {};
    avatar_against_host<Wide>(EmulatedDevice{}, host_queue, c);
    const auto optics = c.avatar.eyes.optics;
    resize_lights(c.avatar.eyes.optics, 0);
    avatar_against_host<Wide>(EmulatedDevice{}, host_queue, c);
    c.avatar.eyes.optics = optics;
    c.avatar.eyes.optics.index = {};
    avatar_against_host<Wide>(EmulatedDevice{}, host_queue, c);
    c.avatar.eyes.optics = {};
    avatar_against_host<Wide>(EmulatedDevice{}, host_queue, c);
    c.avatar.eyes.lid_shadow = c.avatar.eyes.lid_line = {};
    avatar_against_host<Wide>(EmulatedDevice{}, host_queue, c);
    // Without parameters nothing is launched for them, but one filling of kappa's axes.
    CHECK(avatar_work<Wide>(EmulatedDevice{}, host_queue, c).launched ==
          avatar_work<Wide>(EmulatedDevice{}, host_queue, case_with_parts<AllEffects>()).launched);
}
TEST_CASE("cuda, emulated: another gaze alone gives the bits of other drivers, for all parts") {
    AvatarCase<LitEffects> c = case_with_parts<LitEffects>();
    const WorkByDrivers viewed = work_by_drivers<Wide>(EmulatedDevice{}, host_queue, c);
    CHECK(viewed.gaze.at("colours before those by the view") == 1);
    CHECK(viewed.gaze.at("colours by the view") == 1);
    CHECK(viewed.gaze.at("shading") == 1);
    CHECK(viewed.gaze.count("shading by a gaze") == 0);
    CHECK(viewed.gaze.at("network, forward") == 6);
    c.avatar.view_color = {};
    const WorkByDrivers lit = work_by_drivers<Wide>(EmulatedDevice{}, host_queue, c);
    CHECK(lit.gaze.count("colours by the view") == 0);
    CHECK(lit.gaze.at("shading by a gaze") == 1);
    CHECK(lit.gaze.at("eyes, highlights") == 1);
    CHECK(lit.gaze.at("eyes, refraction") == 1);
    CHECK(lit.gaze.at("lids of a frame") == 1);
    CHECK(lit.gaze.at("eyes, shadows of lids") == 1);
    CHECK(lit.gaze.count("light of a frame") == 0);
    CHECK(lit.gaze.at("network, forward") == 6);
}
