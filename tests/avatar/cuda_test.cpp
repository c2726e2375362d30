// SPDX-License-Identifier: Apache-2.0
// An avatar's kernels of a device, run by its emulation on the host.
#include <algorithm>
#include <iterator>

#include "../cuda/avatar_cases.hpp"
#include "../cuda/emulated.hpp"

using namespace rye;
using namespace rye::test;

namespace {

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
    avatar_against_host<Fine>(EmulatedDevice{}, host_queue, c);
    c.column = 1;
    c.config.metric = EuclideanDistance{};
    avatar_against_host<Fine>(EmulatedDevice{PhaseOrder::shuffled}, host_queue, c);
    avatar_against_host<Fine>(EmulatedDevice{PhaseOrder::backward}, host_queue, c);
}
TEST_CASE("cuda, emulated: corrected gazes are the host's") {
    const AvatarCase<AllEffects> c = with_corrections(case_of_all());
    avatar_against_host<Fine>(EmulatedDevice{}, host_queue, c);
    avatar_again<Fine>(EmulatedDevice{PhaseOrder::shuffled}, host_queue, c);
    avatar_by_gaze<Fine>(EmulatedDevice{}, host_queue, c);
    // Without a head pose to correct, and of one eye.
    avatar_against_host<Fine>(
        EmulatedDevice{}, host_queue,
        with_corrections(case_of<Effects<Expression, LeftGaze, Kappa>>()));
    AvatarCase<AllEffects> none = c; // of a frame without corrections
    none.column = -1;
    avatar_against_host<Fine>(EmulatedDevice{}, host_queue, none);
}
TEST_CASE("cuda, emulated: an avatar gives the same bits again, in any order of threads") {
    const AvatarCase<AllEffects> c = case_of_all();
    avatar_again<Fine>(EmulatedDevice{}, host_queue, c);
    const Gaussians<float> cotangent = noise_like(78, c.config.channels);
    CHECK(drive_on<Fine>(EmulatedDevice{}, host_queue, c, cotangent) ==
          drive_on<Fine>(EmulatedDevice{PhaseOrder::shuffled}, host_queue, c, cotangent));
}
TEST_CASE("cuda, emulated: lists of an avatar's points grow") {
    avatar_lists_grow<Fine>(EmulatedDevice{}, host_queue, case_of_all());
}
TEST_CASE("cuda, emulated: what an avatar's device refuses") {
    avatar_bad_input<Fine>(EmulatedDevice{}, host_queue, case_of_all());
}
TEST_CASE("cuda, emulated: an avatar is driven, drawn and differentiated as on the host") {
    avatar_drawn<Fine>(EmulatedDevice{}, host_queue, case_of_all());
}
TEST_CASE("cuda, emulated: another gaze alone gives the bits of other drivers, by fewer launches") {
    const EmulatedDevice device;
    const AvatarCase<AllEffects> c = case_of_all();
    avatar_by_gaze<Fine>(EmulatedDevice{PhaseOrder::shuffled}, host_queue, c);
    using Launches = std::map<std::string, int>;
    const WorkByDrivers all = work_by_drivers<Fine>(device, host_queue, c);
    CHECK(all.all.at("network, forward") == 10);
    CHECK(all.all.at("network's biases") == 10);
    CHECK(all.gaze == Launches{{"codes of a frame", 1},
                               {"network's biases", 4},
                               {"network, forward", 4},
                               {"face by a gaze, features", 1},
                               {"face by a gaze, means", 1},
                               {"eyes' transforms", 1},
                               {"eyes", 1},
                               {"copy", 1}});
    using NoGaze = Less<AllEffects, Periocular, Kappa, LeftGaze, RightGaze>;
    CHECK(work_by_drivers<Fine>(device, host_queue, case_of<NoGaze>()).gaze.empty());
    using Turned = Effects<HeadPose, LeftGaze>;
    CHECK(work_by_drivers<Fine>(device, host_queue, case_of<Turned>()).gaze ==
          Launches{{"codes of a frame", 1}, {"eyes' transforms", 1}, {"eyes", 1}, {"copy", 1}});
}
TEST_CASE("cuda, emulated: points that both gazes move are summed once") {
    const AvatarCase<AllEffects> c = case_of_all();
    const TwoStream<double, AllEffects> avatar = lifted<double>(c.avatar);
    TwoStreamTrace<double, AllEffects> trace;
    drive(ScalarBackend<Serial>{}, avatar, {c.config, c.roles, c.drivers.template cast<double>()},
          trace);
    const std::vector<Index>&left = GazeField<0>{}.deform(trace.face).set,
          &right = GazeField<1>{}.deform(trace.face).set;
    std::vector<Index> both;
    std::set_intersection(left.begin(), left.end(), right.begin(), right.end(),
                          std::back_inserter(both));
    CHECK(both.size() > 0);
    CHECK(both.size() < std::min(left.size(), right.size()));
    // Places of the first list, then of the second, which has those of the first taken out.
    std::vector<std::uint32_t> lists[2];
    std::vector<float> lambda(static_cast<std::size_t>(c.avatar.face.position.cols()));
    for (const Index i : left) {
        lists[0].push_back(static_cast<std::uint32_t>(i));
        lambda[static_cast<std::size_t>(i)] = 1;
    }
    for (const Index i : right) lists[1].push_back(static_cast<std::uint32_t>(i));
    detail::GazedPoints points{};
    std::uint32_t count[2];
    for (int k = 0; k < 2; ++k) {
        count[k] = static_cast<std::uint32_t>(lists[k].size());
        points.of[k] = {{lists[k].data(), &count[k]}, Index(count[k]) + 5, lambda.data()};
    }
    std::vector<Index> found;
    for (Index place = 0; place < points.count(); ++place)
        if (const Index point = points.at(place); point >= 0) found.push_back(point);
    CHECK(found.size() == left.size() + right.size() - both.size());
    std::sort(found.begin(), found.end());
    CHECK(std::adjacent_find(found.begin(), found.end()) == found.end());
}
TEST_CASE("cuda, emulated: places in a list") {
    const std::uint32_t list[] = {2, 3, 7, 40};
    for (std::uint32_t count = 0; count <= 4; ++count)
        for (std::uint32_t index = 0; index < 50; ++index) {
            std::uint32_t place = 0;
            while (place < count && list[place] != index) ++place;
            CHECK(detail::place_in_list(list, count, index) == place);
        }
}
TEST_CASE("cuda, emulated: effects that are off launch nothing and hold nothing") {
    using Launches = std::map<std::string, int>;
    const EmulatedDevice device;
    const AvatarWork none = avatar_work<Fine>(device, host_queue, case_of<Effects<>>());
    CHECK(none.launched == Launches{{"copy", 3},
                                    {"face, activation and head", 1},
                                    {"eyes' transforms", 1},
                                    {"eyes", 1},
                                    {"face, activation and head, reverse", 1},
                                    {"sum of arrays", 2},
                                    {"eyes, reverse", 2}});
    const AvatarWork head = avatar_work<Fine>(device, host_queue, case_of<Effects<HeadPose>>());
    Launches more = none.launched;
    more["codes of a frame"] = more["pose, reverse"] = 1;
    more["merge of sums"] = 3;
    CHECK(head.launched == more);
    const AvatarWork all = avatar_work<Fine>(device, host_queue, case_of_all());
    using NoGaze = Less<AllEffects, Periocular, Kappa, LeftGaze, RightGaze>;
    const AvatarWork fewer = avatar_work<Fine>(device, host_queue, case_of<NoGaze>());
    CHECK(all.launched.at("network, forward") == 10);
    CHECK(fewer.launched.at("network, forward") == 6);
    CHECK(all.launched.at("influence") == 3);
    CHECK(fewer.launched.at("influence") == 1);
    CHECK(none.bytes < 8000);
    CHECK(none.bytes < head.bytes);
    CHECK(head.bytes < fewer.bytes);
    CHECK(fewer.bytes < all.bytes);
}
