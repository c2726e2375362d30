// SPDX-License-Identifier: Apache-2.0
// avatar_device: the cases of avatars, and of what they are made of, on a device; where there is
// none it says so.
#include "on_device.hpp"

#include "avatar_cases.hpp"
#include "point_cases.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using Fine = DeviceNetworks<3, 32, 32, 32>;

AvatarCase<AllEffects> case_of_all() { return {avatar_of_all(), drivers_of_all()}; }

/// Captured once, launched with the drivers of another frame: the bits of a frame that was not.
void graph_case() {
    const AvatarCase<AllEffects> c = case_of_all();
    AvatarCase<AllEffects> before = c;
    before.drivers.expression = -before.drivers.expression;
    before.drivers.pose = -before.drivers.pose;
    const Gaussians<float> cotangent = noise_like(78, c.config.channels);
    const DrivenOnDevice<AllEffects> expected = drive_on<Fine>(CudaDevice(), queue(), c, cotangent);
    DeviceTwoStream<AllEffects, CudaDevice, Fine> avatar(CudaDevice(), queue(),
                                                         {c.avatar, c.config, c.roles});
    Resident<TwoStream<float, AllEffects>, CudaDevice> gradient(CudaDevice(), queue(),
                                                                avatar.layout());
    const auto step = [&] {
        avatar.drive_into(queue());
        avatar.vjp_into(queue(), gradient);
    };
    avatar.set_drivers(queue(), before.drivers);
    send_cloud(CudaDevice(), queue(), cotangent, avatar.g_cloud(queue()));
    step(); // takes the memory
    REQUIRE(avatar.finish(queue()));
    cudaGraph_t graph;
    cudaGraphExec_t exec;
    check_cuda(cudaStreamBeginCapture(queue().stream, cudaStreamCaptureModeThreadLocal), "graph");
    step();
    check_cuda(cudaStreamEndCapture(queue().stream, &graph), "graph");
    check_cuda(cudaGraphInstantiate(&exec, graph, 0), "graph");
    avatar.set_drivers(queue(), c.drivers);
    send_cloud(CudaDevice(), queue(), cotangent, avatar.g_cloud(queue()));
    gradient.clear(queue());
    check_cuda(cudaGraphLaunch(exec, queue().stream), "graph");
    REQUIRE(avatar.finish(queue()));
    TwoStream<float, AllEffects> found = zeros_like(c.avatar);
    gradient.fetch(queue(), found);
    CHECK(fetch_cloud(CudaDevice(), queue(), avatar.cloud()).mean == expected.cloud.mean);
    CHECK(gradients_apart(found, expected.gradient, 0.0) == "");
    check_cuda(cudaGraphExecDestroy(exec), "graph");
    check_cuda(cudaGraphDestroy(graph), "graph");
}

/// The same of a gaze alone.
void gaze_graph_case() {
    const AvatarCase<AllEffects> c = case_of_all();
    DeviceTwoStream<AllEffects, CudaDevice, Fine> avatar(CudaDevice(), queue(),
                                                         {c.avatar, c.config, c.roles});
    avatar.set_drivers(queue(), c.drivers);
    avatar.drive_into(queue(), false);
    avatar.regaze_into(queue());
    REQUIRE(avatar.finish(queue()));
    cudaGraph_t graph;
    cudaGraphExec_t exec;
    check_cuda(cudaStreamBeginCapture(queue().stream, cudaStreamCaptureModeThreadLocal), "graph");
    avatar.regaze_into(queue());
    check_cuda(cudaStreamEndCapture(queue().stream, &graph), "graph");
    check_cuda(cudaGraphInstantiate(&exec, graph, 0), "graph");
    for (const auto& d : {c.drivers, of_another_face(c.drivers)}) {
        avatar.set_drivers(queue(), d);
        avatar.redrive_into(queue());
        for (const float aside : {0.2F, -0.3F}) {
            avatar.set_drivers(queue(), gazing_elsewhere(d, aside));
            check_cuda(cudaGraphLaunch(exec, queue().stream), "graph");
            const Gaussians<float> found = fetch_cloud(CudaDevice(), queue(), avatar.cloud());
            avatar.redrive_into(queue());
            CHECK(same_cloud(found, fetch_cloud(CudaDevice(), queue(), avatar.cloud())));
        }
    }
    check_cuda(cudaGraphExecDestroy(exec), "graph");
    check_cuda(cudaGraphDestroy(graph), "graph");
}

} // namespace

TEST_CASE("device: lists are the host's") { lists_against_host(CudaDevice(), queue()); }
TEST_CASE("device: sums are the host's") { sums_against_host(CudaDevice(), queue()); }
TEST_CASE("device: influences are the host's") {
    influences_against_host(CudaDevice(), queue(), SquaredDistance{});
    influences_against_host(CudaDevice(), queue(), EuclideanDistance{});
}
TEST_CASE("device: codes are the host's") { codes_against_host(CudaDevice(), queue()); }
TEST_CASE("device: networks over the points of a list") {
    mlp_of_a_list<MlpTiles<2, 64, 32>>(CudaDevice(), queue(), 150);
    mlp_of_a_list<MlpTiles<2, 64, 32>>(CudaDevice(), queue(), 1);
    mlp_of_a_list<MlpTiles<1, 128, 32>>(CudaDevice(), queue(), 150, {{21, 128, 128, 5}, 4});
    mlp_of_a_list<MlpTiles<1, 128, 32>>(CudaDevice(), queue(), 1, {{22, 128, 6}, 4});
}
TEST_CASE("device: networks of one column are the host's") {
    mlp_column_against_host(CudaDevice(), queue(), {{21, 300, 33, 5}});
    mlp_column_against_host(CudaDevice(), queue(), {{7, 6}, 0, MlpShape::no_skip});
}
TEST_CASE("device: an avatar of every effect is the host's") {
    AvatarCase<AllEffects> c = case_of_all();
    avatar_against_host<Fine>(CudaDevice(), queue(), c);
    c.column = 1;
    c.config.metric = EuclideanDistance{};
    avatar_against_host<Fine>(CudaDevice(), queue(), c);
}
TEST_CASE("device: gaze mechanisms, driven features and shading are the host's") {
    using Wide = DeviceNetworks<3, 128, 64, 64>;
    mechanisms_against_host<Wide>(CudaDevice(), queue());
    AvatarCase<LitEffects> c = case_with_parts<LitEffects>();
    c.column = 1;
    avatar_against_host<Wide>(CudaDevice(), queue(), c);
    avatar_again<Wide>(CudaDevice(), queue(), c);
}
TEST_CASE("device: corrected gazes are the host's") {
    const AvatarCase<AllEffects> c = with_corrections(case_of_all());
    avatar_against_host<Fine>(CudaDevice(), queue(), c);
    avatar_again<Fine>(CudaDevice(), queue(), c);
}
TEST_CASE("device: an avatar gives the same bits again") {
    avatar_again<Fine>(CudaDevice(), queue(), case_of_all());
}
TEST_CASE("device: lists of an avatar's points grow") {
    avatar_lists_grow<Fine>(CudaDevice(), queue(), case_of_all());
}
TEST_CASE("device: what an avatar's device refuses") {
    avatar_bad_input<Fine>(CudaDevice(), queue(), case_of_all());
}
TEST_CASE("device: an avatar is driven, drawn and differentiated as on the host") {
    avatar_drawn<Fine>(CudaDevice(), queue(), case_of_all());
}
TEST_CASE("device: an avatar driven by a graph, with drivers that change between launches") {
    graph_case();
}
TEST_CASE("device: another gaze alone gives the bits of other drivers") {
    avatar_by_gaze<Fine>(CudaDevice(), queue(), case_of_all());
    variants_by_gaze<DeviceNetworks<3, 128, 64, 64>>(CudaDevice(), queue());
    gaze_graph_case();
}

int main(int argc, char** argv) { return cases_on_device("avatar_device", argc, argv); }
