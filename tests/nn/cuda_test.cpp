// SPDX-License-Identifier: Apache-2.0
// The networks' kernels of a device, run by its emulation on the host.
#include "../cuda/adam_cases.hpp"
#include "../cuda/emulated.hpp"
#include "../cuda/mlp_cases.hpp"

using namespace rye;
using namespace rye::test;

TEST_CASE("cuda, emulated: networks are the host's") {
    for (const auto order : phase_orders) {
        const EmulatedDevice device{order};
        mlp_against_host<MlpTiles<1, 64, 32>>(device, host_queue,
                                              {{{21, 40, 33, 5}, 4}, 150, 1e-2, 0.1});
    }
    const EmulatedDevice device;
    mlp_against_host<MlpTiles<2, 64, 32>>(device, host_queue,
                                          {{{21, 40, 33, 5}, 4}, 150, 2e-5, 2e-4});
    mlp_against_host<MlpTiles<3, 64, 32>>(device, host_queue,
                                          {{{21, 40, 33, 5}, 4}, 70, 1e-6, 2e-6});
}
TEST_CASE("cuda, emulated: networks of several tiles of weights, and more points than a slice") {
    const EmulatedDevice device{PhaseOrder::shuffled};
    mlp_against_host<MlpTiles<1, 256, 128>>(device, host_queue,
                                            {{{136, 256, 150, 28}, 8}, 300, 1e-2, 0.1});
    mlp_against_host<MlpTiles<1, 128, 64>>(device, host_queue,
                                           {{{72, 128, 120, 16}, 8}, 300, 1e-2, 0.1});
    mlp_against_host<MlpTiles<3, 160, 64>>(device, host_queue,
                                           {{{40, 150, 136, 36}, 8}, 300, 2e-6, 1e-5, 1e-5});
}
TEST_CASE("cuda, emulated: networks by groups are the host's") {
    for (const auto order : phase_orders) {
        const EmulatedDevice device{order, 2};
        mlp_against_host<MlpTiles<1, 128, 64>>(device, host_queue,
                                               {{{72, 128, 128, 16}, 8}, 700, 1e-2, 0.1});
    }
    const EmulatedDevice device{PhaseOrder::shuffled, 3};
    mlp_against_host<MlpTiles<1, 128, 32>>(device, host_queue,
                                           {{{35, 128, 128, 128, 128, 3}, 8}, 130, 1e-2, 0.1});
    mlp_against_host<MlpTiles<1, 128, 64>>(device, host_queue, {{{47, 128, 19}, 4}, 64, 1e-2, 0.1});
    mlp_against_host<MlpTiles<1, 128, 128>>(
        device, host_queue, {{{100, 128, 128, 32}, 0, MlpShape::no_skip}, 1, 1e-2, 0.1});
    mlp_against_host<MlpTiles<1, 128, 32>>(device, host_queue, {{{9, 128, 4}, 2}, 0, 1e-2, 0.1});
    mlp_against_host<MlpTiles<1, 256, 128>>(device, host_queue,
                                            {{{136, 256, 256, 28}, 8}, 300, 1e-2, 0.1});
    mlp_against_host<MlpTiles<1, 256, 64>>(device, host_queue, {{{51, 256, 5}, 3}, 65, 1e-2, 0.1});
}
TEST_CASE("cuda, emulated: networks by groups whose operands pass through shared memory") {
    for (const auto order : phase_orders) // rounds in which a group has no points
        mlp_against_host<MlpTiles<1, 256, 64>>(
            EmulatedDevice{order, 2}, host_queue,
            {{{35, 256, 256, 256, 256, 256, 3}, 8}, 300, 1e-2, 0.1});
    const EmulatedDevice device{PhaseOrder::shuffled, 3};
    mlp_against_host<MlpTiles<1, 256, 128>>(device, host_queue,
                                            {{{136, 256, 256, 256, 28}, 8}, 130, 1e-2, 0.1});
    mlp_against_host<MlpTiles<1, 256, 32>>(
        device, host_queue, {{{9, 256, 256, 256, 4}, 0, MlpShape::no_skip}, 1, 1e-2, 0.1});
    mlp_against_host<MlpTiles<1, 256, 32>>(device, host_queue,
                                           {{{9, 256, 256, 256, 4}, 2}, 0, 1e-2, 0.1});
}
TEST_CASE("cuda, emulated: shapes that groups have kernels for") {
    const auto by_groups = [](const EmulatedDevice& device, const MlpShape& s) {
        return DeviceMlp<EmulatedDevice, MlpTiles<1, 128, 64>>(device, s).by_groups();
    };
    const EmulatedDevice groups{PhaseOrder::forward, 2}, none;
    CHECK(by_groups(groups, {{128, 128, 128, 16}, 64}));
    CHECK(!by_groups(none, {{128, 128, 128, 16}, 64}));
    CHECK(!by_groups(groups, {{128, 128, 120, 16}, 64}));
    CHECK(!by_groups(groups, {{128, 128, 128, 33}, 64}));
    CHECK(!by_groups(groups, {{64, 16}, 0}));
    CHECK(!by_groups(groups, {{91, 128, 128, 128, 128, 128, 128, 128, 3}, 64}));
    const auto wide = [&](const MlpShape& s) {
        return DeviceMlp<EmulatedDevice, MlpTiles<1, 256, 64>>(groups, s).by_groups();
    };
    CHECK(wide({{91, 256, 256, 256, 256, 256, 3}, 64}));
    CHECK(!wide({{91, 256, 256, 128, 256, 256, 3}, 64}));
    using Two = DeviceMlp<EmulatedDevice, MlpTiles<2, 128, 64>>;
    CHECK(!Two(groups, {{128, 128, 128, 16}, 64}).by_groups());
}
TEST_CASE("cuda, emulated: networks of one layer, without a skip, of one point and of none") {
    const EmulatedDevice device;
    mlp_against_host<MlpTiles<2, 64, 32>>(device, host_queue,
                                          {{{7, 3}, 0, MlpShape::no_skip}, 33, 2e-5, 2e-5});
    mlp_against_host<MlpTiles<2, 64, 32>>(device, host_queue,
                                          {{{9, 16, 16, 4}, 2, MlpShape::no_skip}, 1, 2e-5, 2e-5});
    mlp_against_host<MlpTiles<2, 64, 32>>(device, host_queue, {{{9, 16, 16, 4}, 2}, 0, 2e-5, 2e-5});
}
TEST_CASE("cuda, emulated: networks that do not fit") { mlp_too_wide(EmulatedDevice{}); }
TEST_CASE("cuda, emulated: Adam is the host's, bit for bit") {
    for (const auto order : {PhaseOrder::forward, PhaseOrder::shuffled})
        adam_against_host(EmulatedDevice{order}, host_queue, 0);
}
