// SPDX-License-Identifier: Apache-2.0
// Work beside the caller's: order, errors, what the caller waits for.
#include <doctest/doctest.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <future>
#include <iostream>
#include <sstream>
#include <stdexcept>
#include <vector>

#include "../support/file_bytes.hpp"
#include "../support/hostile.hpp"
#include "data/work_beside.hpp"
#include "tiny_run.hpp"
#include "training/run_folder.hpp"

using namespace rye;
using namespace rye::trainer;

TEST_CASE("work beside: it runs while the caller goes on, one piece after the other") {
    WorkBeside work("test");
    work.wait(); // for nothing
    std::promise<void> go_on;
    const std::shared_future<void> told = go_on.get_future().share();
    std::vector<int> order;
    work.start([&, told] {
        told.wait(); // for the caller, which is not held up
        order.push_back(1);
    });
    go_on.set_value();
    work.start([&] { order.push_back(2); });
    work.wait();
    CHECK(order == std::vector<int>{1, 2});
    CHECK(work.waited() >= 0);
}

TEST_CASE("work beside: the caller gets its error, once, from the next call") {
    WorkBeside work("test");
    const auto fails = [] { throw Error("x.bin: cannot be written: disk full"); };
    work.start(fails);
    CHECK_FAULT(work.wait(), "x.bin: cannot be written: disk full");
    CHECK_NOTHROW(work.wait());
    work.start(fails);
    bool begun = false;
    CHECK_FAULT(work.start([&] { begun = true; }), "disk full");
    CHECK_FALSE(begun);

    work.start(fails);
    std::string got;
    for (int i = 0; i < 10000 && got.empty(); ++i) {
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
        try {
            work.check();
        } catch (const Error& e) {
            got = e.what();
        }
    }
    CHECK(got == "x.bin: cannot be written: disk full");
    work.start([] { throw 3; });
    CHECK_THROWS_AS(work.wait(), int);
    std::promise<void> go_on;
    work.start([told = go_on.get_future().share()] { told.wait(); });
    CHECK_NOTHROW(work.check()); // does not wait
    go_on.set_value();
}

TEST_CASE("work beside: an error that meets another one is a warning, and the work is done") {
    std::ostringstream said;
    std::streambuf* const before = std::cerr.rdbuf(said.rdbuf());
    bool done = false;
    const auto both = [&] {
        WorkBeside work("test");
        work.start([&] {
            std::this_thread::sleep_for(std::chrono::milliseconds(20));
            done = true;
            throw Error("the files'");
        });
        throw Error("the steps'");
    };
    CHECK_FAULT(both(), "the steps'");
    std::cerr.rdbuf(before);
    CHECK(done);
    CHECK(said.str() == "test: warning: the files'\n");
}

TEST_CASE("work beside: a checkpoint from a copy has the bits of one made at once") {
    const TemporaryFolder temporary;
    const std::filesystem::path& folder = temporary.path;
    TrainState state = tiny_state();
    state.step = 4;
    RunFolder at_once(folder / "at_once", state, Beginning::fresh);
    RunFolder beside(folder / "beside", state, Beginning::fresh);
    at_once.save(state);
    {
        const TrainState copy = state;
        WorkBeside work("test");
        work.start([&] { beside.save(copy); });
        for (int i = 0; i < 50; ++i) beside.log({{"stage", "avatar"}, {"step", i}});
        state.avatar.face.position.setConstant(7); // the steps that follow
        state.step = 5;
    }
    CHECK(bytes_of(checkpoint_path(folder / "beside")).size() > 1000);
    CHECK(bytes_of(checkpoint_path(folder / "beside")) ==
          bytes_of(checkpoint_path(folder / "at_once")));
    int damaged = 0;
    state.step = 100;
    const std::string log = kept_log(folder / "beside" / "log.jsonl", state, damaged);
    CHECK(std::count(log.begin(), log.end(), '\n') == 50);
    CHECK(damaged == 0);
}
