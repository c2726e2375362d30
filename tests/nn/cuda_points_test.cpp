// SPDX-License-Identifier: Apache-2.0
// What avatars on a device are made of, run by the device's emulation on the host.
#include "../cuda/emulated.hpp"
#include "../cuda/point_cases.hpp"

using namespace rye;
using namespace rye::test;

TEST_CASE("cuda, emulated: lists are the host's") {
    for (const auto order : phase_orders) lists_against_host(EmulatedDevice{order}, host_queue);
}
TEST_CASE("cuda, emulated: sums are the host's") {
    for (const auto order : phase_orders) sums_against_host(EmulatedDevice{order}, host_queue);
}
TEST_CASE("cuda, emulated: influences are the host's") {
    influences_against_host(EmulatedDevice{}, host_queue, SquaredDistance{});
    influences_against_host(EmulatedDevice{}, host_queue, EuclideanDistance{});
}
TEST_CASE("cuda, emulated: codes are the host's") {
    codes_against_host(EmulatedDevice{}, host_queue);
}
TEST_CASE("cuda, emulated: networks over the points of a list") {
    for (const auto order : phase_orders)
        mlp_of_a_list<MlpTiles<2, 64, 32>>(EmulatedDevice{order}, host_queue, 150);
    mlp_of_a_list<MlpTiles<2, 64, 32>>(EmulatedDevice{}, host_queue, 64);
    mlp_of_a_list<MlpTiles<2, 64, 32>>(EmulatedDevice{}, host_queue, 1);
}
TEST_CASE("cuda, emulated: networks by groups over the points of a list") {
    const EmulatedDevice device{PhaseOrder::shuffled, 1};
    mlp_of_a_list<MlpTiles<1, 128, 32>>(device, host_queue, 150, {{21, 128, 128, 5}, 4});
    mlp_of_a_list<MlpTiles<1, 128, 32>>(device, host_queue, 1, {{22, 128, 6}, 4});
}
TEST_CASE("cuda, emulated: networks of one column are the host's") {
    for (const auto order : phase_orders)
        mlp_column_against_host(EmulatedDevice{order}, host_queue, {{21, 300, 33, 5}});
    mlp_column_against_host(EmulatedDevice{}, host_queue, {{7, 6}, 0, MlpShape::no_skip});
    mlp_column_against_host(EmulatedDevice{}, host_queue, {{9, 16, 16, 4}, 0, MlpShape::no_skip});
    mlp_column_too_deep(EmulatedDevice{});
}
