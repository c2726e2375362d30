// SPDX-License-Identifier: Apache-2.0
// steps_device: the cases of whole training steps on a device; where there is none it says so.
#include "on_device.hpp"

#include "step_cases.hpp"

#include <rye/backend/cuda/page_locked.hpp>

using namespace rye;
using namespace rye::test;

using Fine = DeviceTrainerPolicy<DeviceNetworks<3, 32, 32, 32>, KernelChannels<3, 8>, Balanced, 3>;

TEST_CASE("device: training steps are the host's") {
    steps_against_host<Fine>(CudaDevice(), queue(), {});
    steps_against_host<Fine>(CudaDevice(), queue(), {.measured = false, .scaled = false});
}
TEST_CASE("device: training steps of a gaze mechanism with generated features") {
    using Wide =
        DeviceTrainerPolicy<DeviceNetworks<3, 128, 64, 32>, KernelChannels<3, 8>, Balanced, 3>;
    using E = More<AllEffects, GazeBy<LearnedQuaternion>, EyesBy<RotatedFeatures>>;
    steps_against_host<Wide, E>(CudaDevice(), queue(), {.gradient = 3e-5});
}
TEST_CASE("device: steps that correct gazes and centre corrections") {
    steps_against_host<Fine>(CudaDevice(), queue(), {.corrected = true});
    rows_centred(CudaDevice(), queue());
}
TEST_CASE("device: training steps give the same bits again, as graphs too") {
    steps_again<Fine>(CudaDevice(), queue());
}
TEST_CASE("device: training steps make room for lists") {
    steps_make_room<Fine>(CudaDevice(), queue());
}
TEST_CASE("device: what training steps refuse") { steps_refused<Fine>(CudaDevice(), queue()); }
TEST_CASE("device: graphs of steps whose renders get more channels later") {
    StepScene scene({});
    const std::vector<StepDraw> few(4, scene.draws[1]); // the eyes in three channels
    std::vector<StepDraw> draws = few;
    draws.push_back(scene.draws[0]);
    draws.insert(draws.end(), few.begin(), few.end());
    StepsOnDevice<CudaDevice, Fine> kept(CudaDevice(), queue(), scene),
        first(CudaDevice(), queue(), scene);
    kept.run(draws);
    for (const StepDraw& d : draws) { // every step as it is
        StepsOnDevice<CudaDevice, Fine> own(CudaDevice(), scene, first);
        own.run({d});
        first.avatar = own.avatar;
        first.adam = own.adam;
    }
    CHECK(kept.differs(first) == "");
}
TEST_CASE("device: a graph of steps for each camera") {
    const StepScene scene({});
    StepsOnDevice<CudaDevice, Fine> own(CudaDevice(), queue(), scene);
    own.run(scene.draws);
    CHECK(own.trainer->graphs() > 0);
    const std::size_t graphs = own.trainer->graphs();
    for (int k = 0; k < 3; ++k) own.run(scene.draws);
    CHECK(own.trainer->graphs() <= 6); // three cameras, with and without eyes
    CHECK(own.trainer->graphs() >= graphs);
}

int main(int argc, char** argv) { return cases_on_device("steps_device", argc, argv); }
TEST_CASE("device: steps of several pictures are the host's") {
    steps_of_pictures<Fine>(CudaDevice(), queue(), 3);
}
TEST_CASE("device: a trainer's memory is counted by an idle queue") {
    PageLockedMemory page_locked;
    steps_counted<Fine>(CudaDevice(), queue(), page_locked);
}
TEST_CASE("device: views that stay in the host's memory give the same bits") {
    PageLockedMemory page_locked;
    steps_from_host<Fine>(CudaDevice(), queue(), page_locked);
}
