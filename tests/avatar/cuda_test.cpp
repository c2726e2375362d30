// SPDX-License-Identifier: Apache-2.0
// An avatar's kernels of a device, run by its emulation on the host.
#include <rye/backend/cuda/emulation.hpp>

#include "../cuda/avatar_cases.hpp"

using namespace rye;
using namespace rye::test;

namespace {

HostMemory memory;
const CudaQueue queue{nullptr, memory};
using Fine = DeviceNetworks<3, 32, 32, 32>;

AvatarCase<AllEffects> case_of_all() { return {avatar_of_all(), drivers_of_all()}; }

/// With fewer effects, what was left out kept at these drivers.
template <EffectSet E>
AvatarCase<E> case_of() {
    const AvatarCase<AllEffects> all = case_of_all();
    const TwoStream<double, AllEffects> a = avatar_of_all();
    return {held<E>(ScalarBackend<Serial>{}, a, all.config, all.roles, drivers_of_all()),
            restricted<E>(drivers_of_all())};
}

} // namespace

TEST_CASE("cuda, emulated: an avatar of every effect is the host's") {
    AvatarCase<AllEffects> c = case_of_all();
    avatar_against_host<Fine>(EmulatedDevice{}, queue, c);
    c.column = 1;
    c.config.metric = EuclideanDistance{};
    avatar_against_host<Fine>(EmulatedDevice{PhaseOrder::shuffled}, queue, c);
    avatar_against_host<Fine>(EmulatedDevice{PhaseOrder::backward}, queue, c);
}
TEST_CASE("cuda, emulated: an avatar gives the same bits again, in any order of threads") {
    const AvatarCase<AllEffects> c = case_of_all();
    avatar_again<Fine>(EmulatedDevice{}, queue, c);
    const Gaussians<float> cotangent = noise_like(78, c.config.channels);
    CHECK(drive_on<Fine>(EmulatedDevice{}, queue, c, cotangent) ==
          drive_on<Fine>(EmulatedDevice{PhaseOrder::shuffled}, queue, c, cotangent));
}
TEST_CASE("cuda, emulated: lists of an avatar's points grow") {
    avatar_lists_grow<Fine>(EmulatedDevice{}, queue, case_of_all());
}
TEST_CASE("cuda, emulated: what an avatar's device refuses") {
    avatar_bad_input<Fine>(EmulatedDevice{}, queue, case_of_all());
}
TEST_CASE("cuda, emulated: an avatar is driven, drawn and differentiated as on the host") {
    avatar_drawn<Fine>(EmulatedDevice{}, queue, case_of_all());
}
TEST_CASE("cuda, emulated: avatars of fewer effects") {
    const EmulatedDevice device;
    avatar_against_host<Fine>(device, queue, case_of<PaperEffects>());
    avatar_against_host<Fine>(device, queue, case_of<Effects<>>());
    avatar_against_host<Fine>(device, queue, case_of<Effects<HeadPose>>());
    avatar_against_host<Fine>(device, queue, case_of<Effects<Expression, LeftGaze, Kappa>>());
    avatar_against_host<Fine>(device, queue, case_of<Effects<PoseResidual, EyeOffset>>());
    avatar_against_host<Fine>(device, queue,
                              case_of<Effects<HeadPose, RightGaze, Periocular, Kappa>>());
}
TEST_CASE("cuda, emulated: influences by two metrics") {
    using Two = More<AllEffects, PoseInfluence<EuclideanDistance>>;
    const AvatarCase<Two> c{restricted<Two>(avatar_of_all()), restricted<Two>(drivers_of_all())};
    avatar_against_host<Fine>(EmulatedDevice{}, queue, c);
}
TEST_CASE("cuda, emulated: effects that are off launch nothing and hold nothing") {
    using Launches = std::map<std::string, int>;
    const EmulatedDevice device;
    const AvatarWork none = avatar_work<Fine>(device, queue, case_of<Effects<>>());
    CHECK(none.launched == Launches{{"copy", 3},
                                    {"face, activation and head", 1},
                                    {"eyes' transforms", 1},
                                    {"eyes", 1},
                                    {"face, activation and head, reverse", 1},
                                    {"sum of arrays", 2},
                                    {"eyes, reverse", 2}});
    const AvatarWork head = avatar_work<Fine>(device, queue, case_of<Effects<HeadPose>>());
    Launches more = none.launched;
    more["codes of a frame"] = more["pose, reverse"] = 1;
    more["merge of sums"] = 3;
    CHECK(head.launched == more);
    const AvatarWork all = avatar_work<Fine>(device, queue, case_of_all());
    using NoGaze = Less<AllEffects, Periocular, Kappa, LeftGaze, RightGaze>;
    const AvatarWork fewer = avatar_work<Fine>(device, queue, case_of<NoGaze>());
    CHECK(all.launched.at("network, forward") == 10);
    CHECK(fewer.launched.at("network, forward") == 6);
    CHECK(all.launched.at("influence") == 3);
    CHECK(fewer.launched.at("influence") == 1);
    CHECK(none.bytes < 8000);
    CHECK(none.bytes < head.bytes);
    CHECK(head.bytes < fewer.bytes);
    CHECK(fewer.bytes < all.bytes);
}
