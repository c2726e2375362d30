// SPDX-License-Identifier: Apache-2.0
#include <rye/nn/adam.hpp>

#include <doctest/doctest.h>

#include <rye/backend/lanes.hpp>
#include <rye/backend/scalar.hpp>

#include "../support/laws.hpp"

using namespace rye;

namespace {

template <class T>
struct Two {
    Columns<T> a, b;
    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        f("a", p.a...);
        f("b", p.b...);
    }
};

template <class T>
Two<T> some(std::uint64_t seed, Index n = 37) {
    return {random_columns<T>(3, n, seed), random_columns<T>(5, n, seed + 100)};
}

const auto everything = [](const std::string&) { return 1e-2; };

} // namespace

TEST_CASE("adam: the first step moves each number by the rate, against its gradient") {
    Two<double> p = some<double>(1);
    const Two<double> before = p, g = some<double>(2);
    Adam<Two<double>> state(p);
    CHECK(adam_step(ScalarBackend<>{}, p, g, state, everything).applied);
    const Columns<double> move = p.a - before.a;
    for (Index i = 0; i < move.size(); ++i)
        CHECK(move(i) == doctest::Approx(g.a(i) > 0 ? -1e-2 : 1e-2).epsilon(1e-6));
    CHECK(state.step == 1);
}

TEST_CASE("adam: follows the formula over many steps, and float follows double") {
    Two<double> p = some<double>(1);
    Two<float> pf{p.a.cast<float>(), p.b.cast<float>()};
    Adam<Two<double>> state(p);
    Adam<Two<float>> statef(pf);
    double x = p.b(3), m = 0, v = 0;
    for (int t = 1; t <= 200; ++t) {
        const Two<double> g = some<double>(static_cast<std::uint64_t>(t) + 5);
        const Two<float> gf{g.a.cast<float>(), g.b.cast<float>()};
        m = 0.9 * m + 0.1 * g.b(3);
        v = 0.999 * v + 0.001 * g.b(3) * g.b(3);
        x -= 1e-2 * (m / (1 - std::pow(0.9, t))) / (std::sqrt(v / (1 - std::pow(0.999, t))) + 1e-8);
        adam_step(XsimdBackend<>{}, p, g, state, everything);
        adam_step(XsimdBackend<>{}, pf, gf, statef, everything);
        CHECK(p.b(3) == doctest::Approx(x).epsilon(1e-12));
    }
    CHECK((p.a - pf.a.cast<double>()).cwiseAbs().maxCoeff() < 2e-5);
}

TEST_CASE("adam: zero gradients do not move anything, and tiny ones do not make a NaN") {
    Two<float> p = some<float>(1), g = some<float>(2);
    const Two<float> before = p;
    g.a.setZero();
    g.b.setConstant(1e-30f);
    Adam<Two<float>> state(p);
    CHECK(adam_step(XsimdBackend<>{}, p, g, state, everything).applied);
    CHECK(p.a == before.a);
    CHECK(p.b.allFinite());
}

TEST_CASE("adam: a gradient that is not finite is named, and stops the step before any change") {
    for (const float bad : {NAN, INFINITY, -INFINITY}) {
        Two<float> p = some<float>(1, 9000), g = some<float>(2, 9000);
        const Two<float> before = p;
        g.b(44999) = bad;
        Adam<Two<float>> state(p);
        const AdamReport report = adam_step(XsimdBackend<>{}, p, g, state, everything);
        CHECK_FALSE(report.applied);
        CHECK(report.first_bad_field == "b");
        CHECK(p.a == before.a);
        CHECK(p.b == before.b);
        CHECK(state.step == 0);
        CHECK(state.m.a.isZero(0));
        // The gradient of an untrained field may be anything.
        const auto only_a = [](const std::string& n) { return n == "a" ? 1e-2 : 0.0; };
        CHECK(adam_step(XsimdBackend<>{}, p, g, state, only_a).applied);
        CHECK(p.a != before.a);
        CHECK(p.b == before.b);
        CHECK(state.v.b.isZero(0));
    }
}

TEST_CASE("adam: a field that starts late takes the same first step") {
    Two<double> p = some<double>(1);
    const Two<double> g = some<double>(2);
    Adam<Two<double>> state(p);
    for (int t = 0; t < 50; ++t)
        adam_step(ScalarBackend<>{}, p, g, state,
                  [](const std::string& n) { return n == "a" ? 1e-2 : 0.0; });
    const Columns<double> before = p.b;
    adam_step(ScalarBackend<>{}, p, g, state, everything);
    CHECK((p.b - before).cwiseAbs().maxCoeff() == doctest::Approx(1e-2).epsilon(1e-6));
    CHECK(state.field_steps == std::vector<Index>{51, 1});
}

TEST_CASE("adam: the same bits with any kind of threads") {
    const auto run = [&]<class B>(B) {
        Two<float> p = some<float>(1, 20000);
        Adam<Two<float>> state(p);
        for (std::uint64_t t = 0; t < 3; ++t)
            adam_step(B{}, p, some<float>(t, 20000), state, everything);
        return p;
    };
    const Two<float> a = run(XsimdBackend<DefaultArch, Serial>{});
    const Two<float> b = run(XsimdBackend<DefaultArch, DefaultThreads>{});
    CHECK(a.a == b.a);
    CHECK(a.b == b.b);
}
