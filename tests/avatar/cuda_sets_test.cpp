// SPDX-License-Identifier: Apache-2.0
// Avatars of many sets of effects on a device, run by its emulation on the host. Each set compiles
// all kernels once more: check.sh --release.
#include "../cuda/avatar_cases.hpp"
#include "../cuda/emulated.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using Fine = DeviceNetworks<3, 32, 32, 32>;
/// With room for the networks of gaze mechanisms.
using Wide = DeviceNetworks<3, 128, 64, 64>;

/// With fewer effects, what was left out kept at these drivers.
template <EffectSet E>
AvatarCase<E> case_of() {
    const AvatarCase<AllEffects> all{avatar_of_all(), drivers_of_all()};
    const TwoStream<double, AllEffects> a = avatar_of_all();
    return {held<E>(ScalarBackend<Serial>{}, a, all.config, all.roles, drivers_of_all()),
            restricted<E>(drivers_of_all())};
}

template <EffectSet E>
void parts_against_host() {
    avatar_against_host<Wide>(EmulatedDevice{}, host_queue, case_with_parts<E>());
}

} // namespace

TEST_CASE("cuda, emulated: avatars of fewer effects") {
    const EmulatedDevice device;
    avatar_against_host<Fine>(device, host_queue, case_of<PaperEffects>());
    avatar_against_host<Fine>(device, host_queue, case_of<Effects<>>());
    avatar_against_host<Fine>(device, host_queue, case_of<Effects<HeadPose>>());
    avatar_against_host<Fine>(device, host_queue, case_of<Effects<Expression, LeftGaze, Kappa>>());
    avatar_against_host<Fine>(device, host_queue, case_of<Effects<PoseResidual, EyeOffset>>());
    avatar_against_host<Fine>(device, host_queue,
                              case_of<Effects<HeadPose, RightGaze, Periocular, Kappa>>());
}
TEST_CASE("cuda, emulated: influences by two metrics") {
    using Two = More<AllEffects, PoseInfluence<EuclideanDistance>>;
    const AvatarCase<Two> c{restricted<Two>(avatar_of_all()), restricted<Two>(drivers_of_all())};
    avatar_against_host<Fine>(EmulatedDevice{}, host_queue, c);
}
TEST_CASE("cuda, emulated: gaze mechanisms are the host's") {
    mechanisms_against_host<Wide>(EmulatedDevice{}, host_queue);
}
TEST_CASE("cuda, emulated: highlights, driven features and shading alone are the host's") {
    parts_against_host<More<PaperEffects, Glint>>();
    parts_against_host<Effects<HeadPose, LeftGaze, Glint>>();
    parts_against_host<Effects<HeadPose, LeftGaze, Glint, Pupil>>();
    parts_against_host<Effects<CornealRefraction>>();
    parts_against_host<More<PaperEffects, Kappa, CornealRefraction>>();
    parts_against_host<Effects<Expression, RightGaze, LidShadow>>();
    parts_against_host<More<AllEffects, LidShadow, GazeBy<LearnedQuaternion>>>();
    parts_against_host<More<PaperEffects, EyesBy<DrivenFeatures>>>();
    parts_against_host<More<PaperEffects, HeadShading>>();
    parts_against_host<More<PaperEffects, ViewColor>>();
    parts_against_host<Effects<Expression, ViewColor>>();
}
TEST_CASE("cuda, emulated: another gaze alone gives the bits of other drivers, for each part") {
    variants_by_gaze<Wide>(EmulatedDevice{}, host_queue);
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
