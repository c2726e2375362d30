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

using HostSteps = StepsOnDevice<EmulatedDevice, Fine>;

/// Takes the scene's steps of two pictures on so many ranks in threads; `prepare` is called with
/// each rank's trainer. Returns the steps' owners.
template <class Prepare>
std::vector<std::unique_ptr<HostSteps>> on_ranks(int ranks, const StepScene& scene,
                                                 const Prepare& prepare) {
    constexpr Index pictures = 2;
    std::vector<std::unique_ptr<HostSteps>> all(static_cast<std::size_t>(ranks));
    run_ranks(ranks, [&](ThreadGroup& group) {
        ThreadRanks end(group);
        auto& own = all[static_cast<std::size_t>(group.rank())];
        own = std::make_unique<HostSteps>(EmulatedDevice{}, host_queue, scene);
        const StepShare share = step_share(pictures, group.rank(), ranks);
        own->trainer->share_steps(host_queue, {share, &end});
        prepare(group.rank(), *own->trainer);
        std::vector<StepDraw> draws;
        for (Index i = 0; i < static_cast<Index>(scene.draws.size()); ++i)
            if (const Index k = i % pictures; k >= share.first && k < share.first + share.count)
                draws.push_back(scene.draws[static_cast<std::size_t>(i)]);
        const DeviceStepsReport r = own->trainer->run(host_queue, draws, group.rank() == 1);
        own->trainer->fetch(host_queue, own->avatar, own->adam);
        REQUIRE(r.steps == 2);
        REQUIRE(r.asked == (ranks > 1)); // by rank 1
    });
    return all;
}

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
TEST_CASE("cuda, emulated: steps of several pictures are the host's") {
    steps_of_pictures<Fine>(EmulatedDevice{}, host_queue, 3);
}
TEST_CASE("cuda, emulated: 1 and 2 ranks give the same bits, also if one lacks room for lists") {
    StepScene scene({});
    scene.draws.resize(4);
    scene.draws[1].rate = 1, scene.draws[2].rate = scene.draws[3].rate = 0.9;
    const auto one = on_ranks(1, scene, [](int, auto&) {});
    const auto two = on_ranks(2, scene, [](int rank, auto& trainer) {
        if (rank == 1) trainer.frame(0).entry_capacity = 5;
    });
    for (const auto& rank : two) CHECK(one[0]->differs(*rank) == "");
    CHECK(one[0]->adam.step == 2);
    IdleMemory nowhere;
    const CudaQueue idle{nullptr, nowhere, true};
    HostSteps would(EmulatedDevice{}, idle, scene);
    IdleRanks ranks(2);
    would.trainer->share_steps(idle, {{0, 1, 2}, &ranks});
    would.run({scene.draws[0], scene.draws[2]});
    CHECK(would.trainer->memory().parameters == two[0]->trainer->memory().parameters);
}
TEST_CASE("cuda, emulated: views that stay in the host's memory give the same bits") {
    HostMemory page_locked;
    steps_from_host<Fine>(EmulatedDevice{}, host_queue, page_locked);
}
TEST_CASE("cuda, emulated: sums over ranks, of any number") {
    for (const int ranks : {1, 2, 3, 5})
        for (const Index n : {1, 7, 100}) {
            const auto number = [](int rank, Index i) {
                return 1.0F / static_cast<float>(1 + 3 * i + 7 * rank);
            };
            run_ranks(ranks, [&](ThreadGroup& group) {
                ThreadRanks end(group);
                std::vector<float> x(
                    static_cast<std::size_t>(DeviceRankSum<EmulatedDevice>::room(n, ranks)));
                for (Index i = 0; i < n; ++i)
                    x[static_cast<std::size_t>(i)] = number(group.rank(), i);
                DeviceRankSum<EmulatedDevice>(EmulatedDevice{})
                    .into(host_queue, end, x.data(), n, RankSum::library); // the tree, of threads
                for (Index i = 0; i < n; ++i) {
                    std::vector<float> terms;
                    for (int r = 0; r < ranks; ++r) terms.push_back(number(r, i));
                    tree_sum(ranks, [&](int to, int from) {
                        terms[static_cast<std::size_t>(to)] += terms[static_cast<std::size_t>(from)];
                    });
                    REQUIRE(x[static_cast<std::size_t>(i)] == terms[0]);
                }
            });
        }
}
TEST_CASE("cuda, emulated: steps that correct gazes and centre corrections") {
    steps_against_host<Fine>(EmulatedDevice{}, host_queue, {.corrected = true});
    rows_centred(EmulatedDevice{}, host_queue);
}
TEST_CASE("cuda, emulated: training steps give the same bits again") {
    steps_again<Fine>(EmulatedDevice{}, host_queue);
}
TEST_CASE("cuda, emulated: a trainer's memory is counted by an idle queue") {
    HostMemory page_locked;
    steps_counted<Fine>(EmulatedDevice{}, host_queue, page_locked);
}
TEST_CASE("cuda, emulated: training steps make room for lists") {
    steps_make_room<Fine>(EmulatedDevice{}, host_queue);
}
TEST_CASE("cuda, emulated: what training steps refuse") {
    steps_refused<Fine>(EmulatedDevice{}, host_queue);
}
