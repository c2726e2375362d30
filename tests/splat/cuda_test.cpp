// SPDX-License-Identifier: Apache-2.0
// The kernels of a device, run by its emulation on the host: the same text with a warp as an array
// of lanes. Phases run in order, backward and shuffled, so that a missing barrier shows.
#include <rye/backend/cuda/emulation.hpp>

#include "../cuda/cases.hpp"

using namespace rye;
using namespace rye::test;

namespace {

HostMemory memory;
const CudaQueue queue{nullptr, memory};
using Three = KernelChannels<3>;

} // namespace

TEST_CASE("cuda, emulated: hard scenes in every order of threads") {
    for (const auto order : {PhaseOrder::forward, PhaseOrder::backward, PhaseOrder::shuffled})
        for (const auto& s : hard_scenes<float>(3))
            against<float, Three>(EmulatedDevice{order}, queue, s, Balanced(), {2e-6, 2e-5, 2e-2});
}

TEST_CASE("cuda, emulated: lists equal the host's") {
    for (const auto& s : hard_scenes<float>(3)) lists_equal<Balanced>(EmulatedDevice{}, queue, s);
    lists_equal<Balanced>(EmulatedDevice{}, queue, random_scene<float>(2000, 3, 5));
}

TEST_CASE("cuda, emulated: a crowded tile") {
    against<double, Three>(EmulatedDevice{PhaseOrder::shuffled}, queue, crowded(2500, true),
                           Balanced());
}

TEST_CASE("cuda, emulated: rules") {
    against<float, Three>(EmulatedDevice{}, queue, random_scene<float>(200, 3, 5),
                          Compatible3dgsFloor());
}

TEST_CASE("cuda, emulated: bad input") { bad_input(EmulatedDevice{}, queue); }

TEST_CASE("cuda, emulated: too little room") { too_little_room(EmulatedDevice{}, queue); }

TEST_CASE("cuda, emulated: contributors") { contributors(EmulatedDevice{}, queue); }

TEST_CASE("cuda, emulated: channels as products of matrices") {
    for (const Index c : {5, 16, 20})
        against<double, KernelChannels<16>>(EmulatedDevice{PhaseOrder::shuffled}, queue,
                                            random_scene<float>(150, c, 5), Balanced(),
                                            {4e-6, 2e-5, 2e-5});
    equal_colours<KernelChannels<16>>(EmulatedDevice{}, queue, 16);
}
TEST_CASE("cuda, emulated: equal colours have no gradient of shape") {
    equal_colours<Three>(EmulatedDevice{}, queue, 3);
}
