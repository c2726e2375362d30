// SPDX-License-Identifier: Apache-2.0
#include <rye/train/fit_lids.hpp>

#include <cmath>
#include <vector>

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>
#include <rye/core/thread_pool.hpp>

#include "../support/tiny_avatar.hpp"

using namespace rye;
using namespace rye::test;

namespace {

constexpr Index blink = 1; ///< coefficient that closes lids

/// An avatar whose expressions displace its Gaussians by up to a fifth of the head.
struct Subject {
    AvatarConfig config = tiny_config();
    LandmarkRoles roles = tiny_roles();
    TwoStream<double> avatar;
    std::vector<VecX<double>> expressions;

    Subject() {
        Draw draw;
        config.deform_scale = 0.2;
        config.attribute_scale = 0.5;
        config.networks.exp_attributes = {24, 24};
        avatar = tiny_avatar(config, draw);
        Columns<double>& last = avatar.face.networks.exp_deform.weight.back();
        last = draw.columns(3, last.cols(), 2);
        FaceNetworks<double>& other = avatar.face.networks; // only the expression displaces
        for (Mlp<double>* m : {&other.pose_deform, &other.gaze_deform[0], &other.gaze_deform[1]}) {
            m->weight.back().setZero();
            m->bias.back().setZero();
        }
        for (int f = 0; f < 4; ++f)
            expressions.push_back(Vec3<double>(0.5 + 0.5 * draw(), 0, 0.5 + 0.5 * draw()));
    }
    template <class Backend>
    FittedLids fit(const Backend& host, TwoStream<double>& a, int steps,
                   const std::vector<Index>& blinks = {blink}, Index lids = 1000) const {
        LidFit fit;
        fit.steps = steps;
        fit.lids = lids;
        fit.rate = 1e-2;
        fit.deform_rate = 1e-3;
        fit.others = 16;
        const auto mixed = [](const Random& random) {
            return VecX<double>(Vec3<double>(0.3 * random.uniform(0), 0, 0.3 * random.uniform(1)));
        };
        return fit_lids(host, a, config, roles, {expressions, blinks, 1.0}, mixed, fit);
    }
    /// The face in the head's frame.
    Gaussians<double> driven(const TwoStream<double>& a, double closed) const {
        Drivers<double> d = tiny_drivers<double>();
        d.expression = Vec3<double>(0, closed, 0);
        d.pose.setZero();
        d.scale = 1;
        TwoStreamTrace<double> trace;
        drive(ScalarBackend<Serial>{}, a, {config, roles, d}, trace);
        Gaussians<double> face = trace.gaussians;
        const Index n = a.face.position.cols();
        Gaussians<double>::fields([&](const std::string&, Columns<double>& c) {
            c = Columns<double>(c.leftCols(n));
        }, face);
        return face;
    }
};

double rms(const Columns<double>& a, const Columns<double>& b) {
    return std::sqrt((a - b).squaredNorm() / static_cast<double>(a.size()));
}

} // namespace

TEST_CASE("growth: mean squared distance to four neighbours, within bounds") {
    Columns<double> before(3, 5), apart;
    before << 0, 1, -1, 0, 0, 0, 0, 0, 1, -1, 0, 0, 0, 0, 0;
    const std::vector<std::array<Index, 4>> near{{1, 2, 3, 4}};
    CHECK(detail::growth_of<double>(before, before, near, 6)[0] == 1);
    apart = before;
    apart.row(0) *= 2; // one direction, by 2: (4 + 1) / 2
    CHECK(detail::growth_of<double>(apart, before, near, 6)[0] == doctest::Approx(2.5));
    CHECK(detail::growth_of<double>(apart, before, near, 2)[0] == 2);
    CHECK(detail::growth_of<double>(before, apart, near, 6)[0] == 1); // lids that open
    apart.setZero();
    CHECK(detail::growth_of<double>(before, apart, near, 6)[0] == 1); // all in one place
}

TEST_CASE("lids that a blink takes into an eyeball are put before it") {
    detail::LidEyeballs<double> eyes{Columns<double>::Zero(3, 2), {1, 1}};
    eyes.centre(0, 0) = 5;
    Columns<double> open(3, 4), points(3, 4);
    open << 5, 5, 0, 5, 1.2, 0.5, 0, 1.2, 0, 0, 1.2, 0;
    points << 5, 5, 0, 5, 0.8, 0.8, 1.1, 0.2, 0, 0, 0, 0;
    Columns<double> moved = points;
    detail::move_out_of_eyeballs(eyes, 0.1, open, moved);
    CHECK((moved.col(0) - Vec3<double>(5, 1.1, 0)).norm() < 1e-12);
    CHECK(moved.col(1) == points.col(1)); // inside with open lids, too
    CHECK((moved.col(2) - Vec3<double>(0, 1.1, 0)).norm() < 1e-12); // no further than it is
    CHECK(moved.col(3) == points.col(3)); // beyond the middle
}

TEST_CASE("points of lids have their neighbours among those around") {
    Draw draw;
    const Columns<double> at = draw.columns(3, 60, 1);
    const detail::NeighbourGraph graph = detail::four_nearest_by_grid(ScalarBackend<Serial>{}, at);
    std::vector<Index> moved;
    std::vector<double> growth;
    for (Index i = 0; i < 60; ++i) {
        moved.push_back(i);
        growth.push_back(i % 3 == 0 ? 2.0 : 1.0);
    }
    const detail::LidPoints all(moved, Columns<double>(Columns<double>::Ones(1, 60)), growth,
                                graph);
    REQUIRE(all.lids.size() == 20);
    REQUIRE(all.others.size() == 40);
    REQUIRE(all.near.size() == 20);
    for (std::size_t k = 0; k < 20; ++k) {
        CHECK(all.around[k] == all.lids[k]);
        for (std::size_t j = 0; j < 4; ++j)
            CHECK(all.around[static_cast<std::size_t>(all.near[k][j])] ==
                  graph[static_cast<std::size_t>(all.lids[k])][j]);
    }
    std::vector<Index> once = all.around;
    std::sort(once.begin(), once.end());
    CHECK(std::adjacent_find(once.begin(), once.end()) == once.end());
}

TEST_CASE("some of many: evenly spread, none twice") {
    for (const double start : {0.0, 0.5, 0.99999999999999999}) {
        const std::vector<Index> some = detail::spread(20, 7, start);
        REQUIRE(some.size() == 7);
        for (std::size_t k = 0; k < 7; ++k) {
            CHECK(some[k] >= static_cast<Index>(20 * k / 7));
            CHECK(some[k] < 20);
            if (k > 0) CHECK(some[k] - some[k - 1] <= 3);
            if (k > 0) CHECK(some[k] > some[k - 1]);
        }
    }
    CHECK(detail::spread(3, 7, 0.5) == std::vector<Index>{0, 1, 2});
    CHECK(detail::spread(0, 7, 0.5).empty());
}

TEST_CASE("lids that are fitted grow as they close, and nothing else changes") {
    const Subject subject;
    TwoStream<double> fitted = subject.avatar;
    Index lids = 1000;
    SUBCASE("all of them in each frame") {}
    SUBCASE("a few of them") { lids = 5; }
    const FittedLids result = subject.fit(ScalarBackend<Serial>{}, fitted, 1500, {blink}, lids);
    CHECK(result.points > 5);
    CHECK(result.points < subject.avatar.face.position.cols() - 5);
    CAPTURE(result.lids.attributes);
    CAPTURE(result.others.attributes);
    CAPTURE(result.lids.place);
    CAPTURE(result.others.place);

    const Gaussians<double> open = subject.driven(subject.avatar, 0),
                            closed = subject.driven(subject.avatar, 1),
                            open_fitted = subject.driven(fitted, 0),
                            closed_fitted = subject.driven(fitted, 1);
    // How much of what neighbours ask for the scales have grown by.
    const detail::NeighbourGraph near =
        detail::four_nearest_by_grid(ScalarBackend<Serial>{}, subject.avatar.face.position);
    const std::vector<double> growth =
        detail::growth_of<double>(closed_fitted.mean, open_fitted.mean, near, 6);
    const Columns<double> influence =
        detail::whole_face<double>(ScalarBackend<Serial>{}, subject.avatar.face, subject.config,
                                   subject.roles).influence;
    double asked = 0, had = 0, has = 0;
    for (Index i = 0; i < open.count(); ++i) {
        const double wanted = std::log(growth[static_cast<std::size_t>(i)]);
        if (wanted < std::log(1.5) || influence(0, i) < 0.7) continue;
        asked += 3 * wanted;
        had += (closed.scale.col(i).array() / open.scale.col(i).array()).log().sum();
        has += (closed_fitted.scale.col(i).array() / open_fitted.scale.col(i).array()).log().sum();
    }
    CAPTURE(asked);
    CAPTURE(had);
    CHECK(asked > 3);
    CHECK(has > 0.7 * asked);
    CHECK(has > had + 0.4 * asked);
    // With open lids the face is what it was.
    CHECK(rms(open.mean, open_fitted.mean) < 0.005);
    CHECK(rms(open.scale.array().log().matrix(), open_fitted.scale.array().log().matrix()) < 0.15);
    CHECK(open.feature == open_fitted.feature);
}

TEST_CASE("fit of lids: nothing without steps or blinks, the same bits by any number of threads") {
    const Subject subject;
    const auto bits = [](const TwoStream<double>& a) {
        std::vector<double> all;
        TwoStream<double>::fields([&](const std::string&, const auto& c) {
            for (Index i = 0; i < c.size(); ++i) all.push_back(static_cast<double>(c(i)));
        }, a);
        return all;
    };
    TwoStream<double> a = subject.avatar;
    CHECK(subject.fit(ScalarBackend<Serial>{}, a, 0).points == 0);
    CHECK(subject.fit(ScalarBackend<Serial>{}, a, 5, {}).points == 0);
    CHECK(bits(a) == bits(subject.avatar));
    subject.fit(ScalarBackend<Serial>{}, a, 5);
    CHECK(bits(a) != bits(subject.avatar));
    ThreadPool pool(3);
    TwoStream<double> b = subject.avatar;
    subject.fit(ScalarBackend<ThreadPool::Handle>{pool.threads()}, b, 5);
    CHECK(bits(a) == bits(b));
}
