// SPDX-License-Identifier: Apache-2.0
// Kernels of gaze mechanisms and eye appearances, run by a device's emulation on the host.
#include "../cuda/avatar_cases.hpp"
#include "../cuda/emulated.hpp"

using namespace rye;
using namespace rye::test;

namespace {

/// With room for the networks of gaze mechanisms.
using Wide = DeviceNetworks<3, 128, 64, 64>;

template <EffectSet E>
void parts_against_host() {
    avatar_against_host<Wide>(EmulatedDevice{}, host_queue, case_with_parts<E>());
}

} // namespace

TEST_CASE("cuda, emulated: gaze mechanisms are the host's") {
    mechanisms_against_host<Wide>(EmulatedDevice{}, host_queue);
}
TEST_CASE("cuda, emulated: driven features, highlights and shading are the host's") {
    parts_against_host<More<PaperEffects, Glint>>();
    parts_against_host<Effects<HeadPose, LeftGaze, Glint>>();
    parts_against_host<More<PaperEffects, EyesBy<DrivenFeatures>>>();
    parts_against_host<More<PaperEffects, HeadShading>>();
    AvatarCase<LitEffects> c = case_with_parts<LitEffects>();
    c.column = 1;
    avatar_against_host<Wide>(EmulatedDevice{PhaseOrder::shuffled}, host_queue, c);
    avatar_again<Wide>(EmulatedDevice{}, host_queue, c);
    avatar_against_host<Wide>(EmulatedDevice{}, host_queue, with_corrections(c));
    c.avatar.shading = {};
    c.avatar.eyes.networks[0] = {};
    avatar_against_host<Wide>(EmulatedDevice{}, host_queue, c);
    c.avatar.eyes.networks[1] = {};
    avatar_against_host<Wide>(EmulatedDevice{}, host_queue, c);
    c.avatar.eyes.optics = {};
    avatar_against_host<Wide>(EmulatedDevice{}, host_queue, c);
    // Without parameters nothing is launched for them, but one filling of kappa's axes.
    CHECK(avatar_work<Wide>(EmulatedDevice{}, host_queue, c).launched ==
          avatar_work<Wide>(EmulatedDevice{}, host_queue, case_with_parts<AllEffects>()).launched);
}
TEST_CASE("cuda, emulated: another gaze alone gives the bits of other drivers, for all parts") {
    variants_by_gaze<Wide>(EmulatedDevice{}, host_queue);
    const WorkByDrivers lit =
        work_by_drivers<Wide>(EmulatedDevice{}, host_queue, case_with_parts<LitEffects>());
    CHECK(lit.gaze.at("shading by a gaze") == 1);
    CHECK(lit.gaze.at("eyes, highlights") == 1);
    CHECK(lit.gaze.count("light of a frame") == 0);
    CHECK(lit.gaze.at("network, forward") == 6);
}
TEST_CASE("cuda, emulated: parts of an eye that turns alone") {
    using Left = Effects<HeadPose, LeftGaze>;
    parts_against_host<More<Left, GazeBy<LearnedQuaternion>, EyesBy<RotatedCode>>>();
    parts_against_host<More<Left, GazeBy<FixedEye>, EyesBy<ConditionedFeatures>>>();
}
TEST_CASE("cuda, emulated: parts give the same bits again, in any order of threads") {
    using E = More<AllEffects, GazeBy<LearnedQuaternion>, EyesBy<ConditionedFeatures>>;
    const AvatarCase<E> c = case_with_parts<E>();
    avatar_again<Wide>(EmulatedDevice{}, host_queue, c);
    const Gaussians<float> cotangent = noise_like(78, c.config.channels);
    CHECK(drive_on<Wide>(EmulatedDevice{}, host_queue, c, cotangent) ==
          drive_on<Wide>(EmulatedDevice{PhaseOrder::shuffled}, host_queue, c, cotangent));
}
TEST_CASE("cuda, emulated: a part launches its own kernels and no other's") {
    const EmulatedDevice device;
    const AvatarWork free =
        avatar_work<Wide>(device, host_queue, case_with_parts<Effects<HeadPose, LeftGaze>>());
    using Still = Effects<HeadPose, LeftGaze, GazeBy<FixedEye>>;
    const AvatarWork still = avatar_work<Wide>(device, host_queue, case_with_parts<Still>());
    CHECK(still.launched == free.launched);
    CHECK(still.bytes == free.bytes);
    const AvatarWork code =
        avatar_work<Wide>(device, host_queue, case_with_parts<More<Still, EyesBy<RotatedCode>>>());
    std::map<std::string, int> more = free.launched;
    --more["copy"], --more["sum of arrays"];
    more["triplets turned"] = more["triplets turned, reverse"] = 1;
    more["network's operands"] = more["network's biases"] = more["network, forward"] = 2;
    more["network, reverse"] = 2;
    more["network's weights"] = more["merge of weights"] = more["gradient of frame inputs"] = 2;
    for (const auto& launch : code.launched) {
        CAPTURE(launch.first);
        CHECK(launch.second == more[launch.first]);
    }
    CHECK(code.launched.size() == more.size());
    CHECK(code.bytes > free.bytes);
}
TEST_CASE("cuda, emulated: parameters of other points are refused") {
    using E = More<Effects<LeftGaze>, GazeBy<FixedEye>, EyesBy<RotatedFeatures>>;
    AvatarCase<E> c = case_with_parts<E>();
    c.avatar.eyes.latent = Columns<float>::Zero(30, 3);
    using Avatar = DeviceTwoStream<E, EmulatedDevice, Wide>;
    CHECK_FAULT(Avatar(EmulatedDevice{}, host_queue, {c.avatar, c.config, c.roles}),
                "DeviceEyeAppearance: latent is 30 x 3, expected 30 x 18");
}
