// SPDX-License-Identifier: Apache-2.0
#include <chrono>
#include <functional>
#include <limits>
#include <string>
#include <thread>
#include <vector>

#include <doctest/doctest.h>

#include <rye/train/avatar_trainer.hpp>
#include <rye/train/thread_group.hpp>

#include "../support/tiny_sample.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using FloatAvatar = TwoStream<float>;
constexpr Index pictures = 8, steps = 3;

AvatarTraining<> training() {
    AvatarTraining<> t;
    t.config = tiny_config();
    t.roles = tiny_roles();
    t.objective.weights.eye_smooth = 0.1;
    return t;
}

/// Returns picture k of a step, of another frame, gaze and noise each.
AvatarSample<float> picture(Index step, Index k) {
    AvatarSample<float> s = tiny_sample<float>(
        Draw{{static_cast<std::uint64_t>(9 + step), static_cast<std::uint64_t>(k)}});
    s.frame = k % 2;
    s.drivers.expression *= 1.0F - 0.1F * static_cast<float>(k);
    return s;
}

struct Ranked {
    FloatAvatar avatar;
    Adam<FloatAvatar> adam;
    std::vector<AvatarStepReport<float>> reports;
};

/// Settings of a case: what a rank does before a step, and its picture.
struct Faults {
    std::function<void(int rank, Index step)> before = [](int, Index) {};
    std::function<void(AvatarSample<float>&, Index step, Index k)> spoil = [](AvatarSample<float>&,
                                                                              Index, Index) {};
};

template <class G>
Ranked train(G& group, Index all = pictures, const Faults& faults = {}) {
    Draw draw{{4, 3}};
    Ranked r;
    r.avatar = lifted<float>(tiny_avatar(tiny_config(), draw));
    r.adam = Adam<FloatAvatar>(r.avatar);
    AvatarTrainer trainer{ScalarBackend<Serial>{}, r.avatar, r.adam, training()};
    const StepShare own = step_share(all, group.rank(), group.size());
    for (Index s = 0; s < steps; ++s) {
        faults.before(group.rank(), s);
        for (Index k = own.first; k < own.first + own.count; ++k) {
            AvatarSample<float> sample = picture(s, k);
            faults.spoil(sample, s, k);
            trainer.add(sample.drivers, sample, all);
        }
        r.reports.push_back(trainer.take(group));
    }
    return r;
}

/// Returns the avatars of all ranks.
std::vector<Ranked> train_ranks(int ranks, Index all = pictures, const Faults& faults = {}) {
    std::vector<Ranked> of_rank(static_cast<std::size_t>(ranks));
    run_ranks(ranks, [&](ThreadGroup& group) {
        of_rank[static_cast<std::size_t>(group.rank())] = train(group, all, faults);
    });
    return of_rank;
}

/// Returns the names of the fields that differ in a bit.
std::string different(const Ranked& a, const Ranked& b) {
    std::string names;
    FloatAvatar::fields(
        [&](const std::string& name, const auto& x, const auto& y, const auto& m, const auto& n,
            const auto& v, const auto& w) {
            if (!(x == y && m == n && v == w)) names += name + " ";
        },
        a.avatar, b.avatar, a.adam.m, b.adam.m, a.adam.v, b.adam.v);
    if (a.adam.step != b.adam.step) names += "steps ";
    for (std::size_t s = 0; s < a.reports.size(); ++s)
        AvatarLosses<float>::fields(
            [&](const char* name, float x, float y) {
                if (!(x == y)) names += std::string(name) + " ";
            },
            a.reports[s].losses, b.reports[s].losses);
    return names;
}

/// Returns the order of additions as brackets.
std::string brackets(int count) {
    std::vector<std::string> x;
    for (int i = 0; i < count; ++i) x.push_back(std::to_string(i));
    tree_sum(count, [&](int to, int from) {
        auto& a = x[static_cast<std::size_t>(to)];
        a = "(" + a + "+" + x[static_cast<std::size_t>(from)] + ")";
    });
    return x[0];
}

} // namespace

TEST_CASE("sums of pictures one by one have the order of the tree") {
    CHECK(brackets(7) == "(((0+1)+(2+3))+((4+5)+6))");
    for (int count = 1; count <= 33; ++count) {
        std::vector<std::string> level(8);
        int most = 0;
        TreeLevels levels;
        const auto join = [&](int to) {
            auto& a = level[static_cast<std::size_t>(to)];
            a = "(" + a + "+" + level[static_cast<std::size_t>(to) + 1] + ")";
        };
        for (int i = 0; i < count; ++i)
            levels.add(
                [&](int at) {
                    most = std::max(most, at + 1);
                    level[static_cast<std::size_t>(at)] = std::to_string(i);
                },
                join);
        levels.close(join);
        CHECK(level[0] == brackets(count));
        CHECK(most <= TreeLevels::levels(count));
    }
}

TEST_CASE("ranks share the pictures of a step without gaps") {
    for (const int size : {1, 2, 3, 8})
        for (Index all = size; all < 20; ++all) {
            Index next = 0;
            for (int r = 0; r < size; ++r) {
                const StepShare s = step_share(all, r, size);
                CHECK((s.first == next && s.count >= 1 && s.all == all));
                next += s.count;
            }
            CHECK(next == all);
        }
    CHECK_THROWS_WITH(step_share(2, 0, 3),
                      "step_share: a step shows 2 pictures, expected 3 or "
                      "more, one for each rank");
    CHECK_THROWS_WITH(step_share(2, 2, 2),
                      "step_share: got rank 2 of 2, expected a rank from 0 to 1");
}

TEST_CASE("a step of one added picture is the step of that picture, bit for bit") {
    Alone alone;
    const Ranked added = train(alone, 1);
    Ranked stepped = added;
    Draw draw{{4, 3}};
    stepped.avatar = lifted<float>(tiny_avatar(tiny_config(), draw));
    stepped.adam = Adam<FloatAvatar>(stepped.avatar);
    stepped.reports.clear();
    AvatarTrainer trainer{ScalarBackend<Serial>{}, stepped.avatar, stepped.adam, training()};
    for (Index s = 0; s < steps; ++s) stepped.reports.push_back(trainer.step(picture(s, 0)));
    CHECK(different(added, stepped) == "");
}

TEST_CASE("the gradient of a step of several pictures is their mean") {
    Draw draw{{4, 3}};
    const TwoStream<double> avatar = tiny_avatar(tiny_config(), draw);
    TwoStream<double> moved = avatar, sum = zeros_like(avatar);
    Adam<TwoStream<double>> adam(moved);
    AvatarTrainer trainer{ScalarBackend<Serial>{}, moved, adam, training()};
    const auto sample = [](Index k) {
        AvatarSample<double> s = tiny_sample<double>(Draw{{9, static_cast<std::uint64_t>(k)}});
        s.frame = k % 2;
        return s;
    };
    double loss = 0;
    for (Index k = 0; k < 3; ++k) {
        const AvatarSample<double> s = sample(k);
        TwoStream<double> one = avatar;
        Adam<TwoStream<double>> of_one(one);
        AvatarTrainer alone{ScalarBackend<Serial>{}, one, of_one, training()};
        loss += alone.step(s).losses.total / 3;
        TwoStream<double>::fields(
            [](const std::string&, auto& a, const auto& m) { a += m / 0.1 / 3; }, sum, of_one.m);
        trainer.add(s.drivers, s, 3);
    }
    CHECK(std::abs(trainer.take().losses.total - loss) <= 1e-12 * loss);
    double apart = 0, size = 0;
    TwoStream<double>::fields(
        [&](const std::string&, const auto& a, const auto& m) {
            apart = std::max(apart, (a - m / 0.1).cwiseAbs().maxCoeff());
            size = std::max(size, a.cwiseAbs().maxCoeff());
        },
        sum, adam.m);
    CHECK(size > 1e-3);
    CHECK(apart <= 1e-12 * size);
}

TEST_CASE("1, 2, 4 and 8 ranks give the same bits, and every rank the same avatar") {
    Alone alone;
    const Ranked one = train(alone);
    CHECK(one.reports.back().adam.applied);
    for (const int ranks : {1, 2, 4, 8}) {
        CAPTURE(ranks);
        for (const Ranked& r : train_ranks(ranks)) CHECK(different(one, r) == "");
    }
}

TEST_CASE("3 ranks of 8 pictures differ from one by the order of sums alone") {
    Alone alone;
    const Ranked one = train(alone);
    const std::vector<Ranked> three = train_ranks(3);
    CHECK(different(three[0], three[1]) == "");
    CHECK(different(three[0], three[2]) == "");
    FloatAvatar::fields(
        [](const std::string& name, const auto& a, const auto& b) {
            CAPTURE(name);
            CHECK((a - b).cwiseAbs().maxCoeff() <= 2e-5F * a.cwiseAbs().maxCoeff());
        },
        one.adam.m, three[0].adam.m);
}

TEST_CASE("a rank that is late changes nothing") {
    Alone alone;
    Faults faults;
    faults.before = [](int rank, Index step) {
        if (rank == static_cast<int>(step))
            std::this_thread::sleep_for(std::chrono::milliseconds(50));
    };
    const std::vector<Ranked> ranks = train_ranks(2, pictures, faults);
    CHECK(different(train(alone), ranks[0]) == "");
    CHECK(different(ranks[0], ranks[1]) == "");
}

TEST_CASE("a rank that ends, ends the others with its reason") {
    for (const int which : {0, 1, 2}) {
        CAPTURE(which);
        Faults faults;
        faults.before = [&](int rank, Index step) {
            if (rank == which && step == 1) throw Error("a disk is full");
        };
        std::vector<std::string> reasons(3);
        CHECK_THROWS_WITH(run_ranks(3,
                                    [&](ThreadGroup& group) {
                                        try {
                                            train(group, 3, faults);
                                        } catch (const std::exception& e) {
                                            reasons[static_cast<std::size_t>(group.rank())] =
                                                e.what();
                                            throw;
                                        }
                                    }),
                          "a disk is full");
        for (int r = 0; r < 3; ++r)
            CHECK(reasons[static_cast<std::size_t>(r)] ==
                  (r == which ? std::string("a disk is full")
                              : "rank " + std::to_string(which) + " ended: a disk is full"));
    }
}

TEST_CASE("a gradient that is not finite on one rank is refused by all, which go on alike") {
    Faults faults;
    faults.spoil = [](AvatarSample<float>& sample, Index step, Index k) {
        if (step == 1 && k == 5)
            sample.drivers.expression(0) = std::numeric_limits<float>::quiet_NaN();
    };
    Alone alone;
    const Ranked one = train(alone, pictures, faults);
    CHECK(one.adam.step == steps - 1);
    CHECK(!one.reports[1].adam.applied);
    for (const Ranked& r : train_ranks(4, pictures, faults)) {
        CHECK(!r.reports[1].adam.applied);
        CHECK(r.reports[1].adam.first_bad_field == one.reports[1].adam.first_bad_field);
        CHECK(r.adam.step == steps - 1);
        CHECK((r.avatar.face.position == one.avatar.face.position &&
               r.avatar.eyes.position == one.avatar.eyes.position));
    }
}

TEST_CASE("a rank that is done leaves nobody waiting") {
    CHECK_THROWS_WITH(run_ranks(2, [&](ThreadGroup& group) {
                          group.meet();
                          if (group.rank() == 1) group.meet();
                      }),
                      "rank 0 is done, while others wait for it");
}

TEST_CASE("ranks whose arrays differ are told which") {
    CHECK_THROWS_WITH(
        run_ranks(2,
                  [&](ThreadGroup& group) {
                      std::vector<float> x(static_cast<std::size_t>(3 + group.rank()));
                      group.sum(detail::GroupArrays<float>{x});
                  }),
        "ThreadGroup: array 0 of rank 1 has 4 numbers, that of rank 0 has 3");
    CHECK_THROWS_WITH(run_ranks(0, [](ThreadGroup&) {}),
                      "ThreadMeeting: got 0 ranks, expected 1 or more");
    std::vector<int> values(3);
    run_ranks(3, [&](ThreadGroup& group) {
        values[static_cast<std::size_t>(group.rank())] = group.given(7 + group.rank());
    });
    CHECK(values == std::vector<int>{7, 7, 7});
}
