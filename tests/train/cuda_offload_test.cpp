// SPDX-License-Identifier: Apache-2.0
// Stage 1 with its networks' kernels of a device, run by its emulation on the host.
#include "../cuda/emulated.hpp"
#include "../cuda/offload_cases.hpp"
#include "../cuda/offload_network_cases.hpp"

using namespace rye;
using namespace rye::test;

TEST_CASE("cuda, emulated: a step of stage 1 is the host's") {
    using Three = MlpTiles<3, 32, 64>;
    const auto step =
        mesh_step_against_host<Three>(EmulatedDevice{}, host_queue, host_memory, 1e-5);
    mesh_step_by_size<Three>(EmulatedDevice{PhaseOrder::shuffled}, host_queue, host_memory, step);
}
TEST_CASE("cuda, emulated: a step of stage 1 with two planes is near the host's") {
    mesh_step_against_host<MlpTiles<2, 32, 64>>(EmulatedDevice{}, host_queue, host_memory, 1e-3);
}
TEST_CASE("cuda, emulated: a step of stage 1 with one plane has the losses, not the gradient") {
    // Where a lattice edge has two distances that are nearly the same, the place between them is
    // rounding: a bf16 has 8 bits.
    OffloadCounts counts;
    const auto step =
        offloaded_step<MlpTiles<1, 32, 64>>(EmulatedDevice{}, host_queue, host_memory, 1, counts);
    const auto gaps = step_gaps(step, mesh_step<double>(ScalarBackend<>{}));
    for (const char* loss : {"rgb", "silhouette", "deform", "offset", "laplacian", "total"})
        CHECK(beyond(0.03, gaps, loss) == "");
    CHECK(beyond(0.15, gaps, "exp_color_mlp") == "");
    CHECK(beyond(0.5, gaps, "geo_mlp") != "");
}
TEST_CASE("cuda, emulated: training of stage 1 is the host's") {
    mesh_training_against_host<MlpTiles<2, 32, 64>>(EmulatedDevice{}, host_queue, host_memory,
                                                    1e-3);
}
TEST_CASE("cuda, emulated: the fit to landmarks is the host's") {
    fit_against_host<MlpTiles<2, 32, 64>>(EmulatedDevice{}, host_queue, 2e-2);
    fit_against_host<MlpTiles<3, 32, 64>>(EmulatedDevice{PhaseOrder::shuffled}, host_queue, 2e-3,
                                          false);
}
TEST_CASE("cuda, emulated: networks of an offload are the host's") {
    offload_against_host<MlpTiles<2, 64, 32>>(EmulatedDevice{}, host_queue, host_memory, 1e-3);
    offload_against_host<MlpTiles<3, 64, 32>>(EmulatedDevice{}, host_queue, host_memory, 1e-5);
}
TEST_CASE("cuda, emulated: faults of an offload") {
    offload_faults(EmulatedDevice{}, host_queue, host_memory);
}
