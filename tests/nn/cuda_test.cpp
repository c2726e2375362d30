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
