// SPDX-License-Identifier: Apache-2.0
// Whole training steps on a device, run by its emulation on the host.
#include "../cuda/emulated.hpp"
#include "../cuda/step_cases.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using Fine = DeviceTrainerPolicy<DeviceNetworks<3, 32, 32, 32>, KernelChannels<3, 8>, Balanced, 3>;

/// Graphs of a device that only counts.
struct CountingDevice {
    static inline int captures = 0, launches = 0;
    struct Graph {
        template <class F>
        static Graph of(const CudaQueue&, const F&) {
            ++captures;
            return {};
        }
        void launch(const CudaQueue&) const { ++launches; }
    };
};

} // namespace

TEST_CASE("kept graphs: the first work of a kind runs as it is, and others are captured anew") {
    KeptGraphs<CountingDevice, int, int> graphs;
    int runs = 0;
    const auto work = [&] { ++runs; };
    graphs.run(host_queue, 0, 7, work); // takes its memory
    CHECK(runs == 1);
    graphs.run(host_queue, 0, 7, work);
    graphs.run(host_queue, 0, 7, work);
    CHECK((runs == 1 && CountingDevice::captures == 1 && CountingDevice::launches == 2));
    graphs.run(host_queue, 1, 8, work); // may move what kind 0 uses
    CHECK((runs == 2 && graphs.size() == 0));
    graphs.run(host_queue, 0, 7, work);
    CHECK((runs == 2 && CountingDevice::captures == 2 && CountingDevice::launches == 3));
    graphs.forget();
    graphs.run(host_queue, 0, 7, work);
    CHECK((runs == 3 && graphs.size() == 0));
}
TEST_CASE("cuda, emulated: training steps are the host's") {
    steps_against_host<Fine>(EmulatedDevice{}, host_queue, {});
    steps_against_host<Fine>(EmulatedDevice{PhaseOrder::shuffled}, host_queue,
                             {.measured = false, .scaled = false});
}
TEST_CASE("cuda, emulated: steps that correct gazes and centre corrections") {
    steps_against_host<Fine>(EmulatedDevice{}, host_queue, {.corrected = true});
    rows_centred(EmulatedDevice{}, host_queue);
}
TEST_CASE("cuda, emulated: training steps give the same bits again") {
    steps_again<Fine>(EmulatedDevice{}, host_queue);
}
TEST_CASE("cuda, emulated: training steps make room for lists") {
    steps_make_room<Fine>(EmulatedDevice{}, host_queue);
}
TEST_CASE("cuda, emulated: what training steps refuse") {
    steps_refused<Fine>(EmulatedDevice{}, host_queue);
}
TEST_CASE("cuda, emulated: training steps of a gaze mechanism with generated features") {
    using Wide =
        DeviceTrainerPolicy<DeviceNetworks<3, 128, 64, 32>, KernelChannels<3, 8>, Balanced, 3>;
    using E = More<AllEffects, GazeBy<LearnedQuaternion>, EyesBy<RotatedFeatures>>;
    // An eye's turn sums the cotangents of all of its points, in float.
    steps_against_host<Wide, E>(EmulatedDevice{}, host_queue, {.gradient = 3e-5});
}
