// SPDX-License-Identifier: Apache-2.0
// What avatars on a device are made of, run by the device's emulation on the host.
#include <rye/backend/cuda/emulation.hpp>

#include "../cuda/point_cases.hpp"

using namespace rye;
using namespace rye::test;

namespace {

HostMemory memory;
const CudaQueue queue{nullptr, memory};
constexpr PhaseOrder orders[] = {PhaseOrder::forward, PhaseOrder::backward, PhaseOrder::shuffled};

} // namespace

TEST_CASE("cuda, emulated: lists are the host's") {
    for (const auto order : orders) lists_against_host(EmulatedDevice{order}, queue);
}
TEST_CASE("cuda, emulated: sums are the host's") {
    for (const auto order : orders) sums_against_host(EmulatedDevice{order}, queue);
}
TEST_CASE("cuda, emulated: influences are the host's") {
    influences_against_host(EmulatedDevice{}, queue, SquaredDistance{});
    influences_against_host(EmulatedDevice{}, queue, EuclideanDistance{});
}
TEST_CASE("cuda, emulated: codes are the host's") { codes_against_host(EmulatedDevice{}, queue); }
TEST_CASE("cuda, emulated: networks over the points of a list") {
    for (const auto order : orders)
        mlp_of_a_list<MlpTiles<2, 64, 32>>(EmulatedDevice{order}, queue, 150);
    mlp_of_a_list<MlpTiles<2, 64, 32>>(EmulatedDevice{}, queue, 64);
    mlp_of_a_list<MlpTiles<2, 64, 32>>(EmulatedDevice{}, queue, 1);
}
TEST_CASE("cuda, emulated: networks of one column are the host's") {
    for (const auto order : orders)
        mlp_column_against_host(EmulatedDevice{order}, queue, {{21, 300, 33, 5}});
    mlp_column_against_host(EmulatedDevice{}, queue, {{7, 6}, 0, MlpShape::no_skip});
    mlp_column_against_host(EmulatedDevice{}, queue, {{9, 16, 16, 4}, 0, MlpShape::no_skip});
    mlp_column_too_deep(EmulatedDevice{});
}
