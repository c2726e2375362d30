// SPDX-License-Identifier: Apache-2.0
#include <rye/avatar/view_color.hpp>

#include <cmath>

#include <doctest/doctest.h>

#include <rye/backend/lanes.hpp>
#include <rye/backend/scalar.hpp>
#include <rye/gaussian/sh_color.hpp>

#include "../support/avatar_law.hpp"
#include "../support/neutral_law.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using Viewed = More<PaperEffects, ViewColor>;
/// Everything that moves a Gaussian's mean, and what multiplies its colour.
using Seen = More<AllEffects, CornealRefraction, Glint, Pupil, HeadShading, ViewColor>;

template <EffectSet E>
TwoStream<double, E> viewed_avatar(int degree = 3) {
    TwoStream<double, E> a = avatar_with_parts<E>();
    set_tiny_view_colors(a, degree);
    return a;
}
template <EffectSet E>
Drivers<double, E> viewed_drivers() {
    return seen_drivers<E>(tiny_drivers<double>());
}
template <EffectSet E>
Columns<double> colours(const TwoStream<double, E>& a, const Drivers<double, E>& d) {
    return driven(a, d).gaussians.feature;
}

} // namespace

TEST_CASE("view color: what is added is what a cloud of harmonics shows, the head at rotation 0") {
    for (const int degree : {1, 2, 3}) {
        const TwoStream<double, Viewed> avatar = viewed_avatar<Viewed>(degree);
        Drivers<double, Viewed> at = viewed_drivers<Viewed>();
        at.pose.head<3>().setZero();
        const auto with = driven(avatar, at);
        const auto without = driven(restricted<PaperEffects>(avatar), restricted<PaperEffects>(at));
        const Index n = with.gaussians.count(), rows = avatar.view_color.face.rows();
        GaussianCloud<double> cloud;
        cloud.mean = with.gaussians.mean;
        cloud.sh_constant = Columns<double>::Constant(3, n, 30); // far from the clamp at 0
        cloud.sh_rest.resize(rows, n);
        cloud.sh_rest << avatar.view_color.face, avatar.view_color.eyes;
        const Columns<double> rest = sh_colors(cloud, at.camera);
        cloud.sh_rest.setZero();
        const Columns<double> added = rest - sh_colors(cloud, at.camera);
        const Columns<double> change = with.gaussians.feature - without.gaussians.feature;
        CHECK((change.topRows(3) - added).cwiseAbs().maxCoeff() <= 1e-14 * 30);
        CHECK(added.cwiseAbs().maxCoeff() > 0.1);
        CHECK(change.bottomRows(change.rows() - 3).isZero(0));
        CHECK(with.gaussians.mean == without.gaussians.mean);
    }
}

TEST_CASE("view color: head and camera that turn together change nothing, the head alone does") {
    const TwoStream<double, Viewed> a = viewed_avatar<Viewed>();
    // Without networks that read the pose.
    using Still = Effects<HeadPose, LeftGaze, RightGaze, ViewColor>;
    const TwoStream<double, Still> avatar = restricted<Still>(a);
    Drivers<double, Still> at = viewed_drivers<Still>(), turned = at;
    at.pose.head<3>().setZero();
    turned.pose = at.pose;
    const Vec3<double> turn(0.3, -0.5, 0.2);
    const Mat3<double> r = so3_exp(turn);
    turned.pose.head<3>() = turn;
    turned.pose.tail<3>() = r * Vec3<double>(at.pose.tail<3>());
    CHECK((colours(avatar, turned) - colours(avatar, at)).cwiseAbs().maxCoeff() > 0.01);
    turned.camera = r * at.camera;
    CHECK((colours(avatar, turned) - colours(avatar, at)).cwiseAbs().maxCoeff() <= 1e-13);
}

TEST_CASE("view color: the vjp is the transpose of the duals") {
    for (const int degree : {1, 2, 3}) {
        CHECK(law_error<Viewed>(viewed_avatar<Viewed>(degree), viewed_drivers<Viewed>(), 1) <=
              1e-12);
    }
    CHECK(law_error<Seen>(viewed_avatar<Seen>(), viewed_drivers<Seen>(), 2) <= 1e-11);
    using Headless = Effects<Expression, LeftGaze, ViewColor>;
    CHECK(law_error<Headless>(viewed_avatar<Headless>(), viewed_drivers<Headless>(), 3) <= 1e-12);
    CHECK(difference_error(viewed_avatar<Viewed>(), viewed_drivers<Viewed>(), 5) <= 1e-6);
}

TEST_CASE("view color: at a point, duals of mean and rotation agree with the vjp") {
    using D = Dual<double, 12>;
    Draw draw{{11, 2}};
    const Columns<double> own = draw.columns(45, 1), x = draw.columns(3, 3);
    const Mat3<double> r = so3_exp(Vec3<double>(x.col(2)));
    detail::SeenHead<D> seen{Vec3<double>(x.col(1)).cast<D>(), r.cast<D>()};
    Vec3<D> mean;
    Columns<D> dual = own.cast<D>();
    for (int k = 0; k < 3; ++k) mean[k] = D::variable(x(k, 0), k);
    for (int k = 0; k < 9; ++k) seen.rotation.data()[k] = D::variable(r.data()[k], 3 + k);
    const Vec3<double> g(0.7, -1.1, 0.4);
    const detail::ViewedPoint<D, 3> point(mean, seen);
    D value = D(0);
    for (int c = 0; c < 3; ++c) value += D(g[c]) * point.channel(dual.data(), c);
    Columns<double> g_mean = Columns<double>::Zero(3, 1), g_own = Columns<double>::Zero(45, 1);
    const Columns<double> mean_of = x.leftCols(1), feature = g;
    detail::SumsOf<detail::AddViewColorVjp<double, 3>> sums;
    const detail::AddViewColorVjp<double, 3> vjp{
        mean_of.data(), {Vec3<double>(x.col(1)), r}, 3, feature.data(), g_mean.data()};
    vjp.add(0, own.data(), g_own.data(), sums);
    for (std::size_t k = 0; k < 3; ++k)
        CHECK(g_mean(Index(k)) == doctest::Approx(value.d[k]).epsilon(1e-12));
    for (std::size_t k = 0; k < 9; ++k)
        CHECK(sums[k] == doctest::Approx(value.d[3 + k]).epsilon(1e-12));
}

TEST_CASE("view color: zero coefficients, and none, change no bit") {
    TwoStream<double, Seen> avatar = viewed_avatar<Seen>();
    const Drivers<double, Seen> at = viewed_drivers<Seen>();
    using Rest = Less<Seen, ViewColor>;
    const Columns<double> plain = colours(restricted<Rest>(avatar), restricted<Rest>(at));
    CHECK(colours(avatar, at) != plain);
    Drivers<double, Seen> drivers = at;
    make_neutral<ViewColor>(avatar, drivers);
    CHECK(colours(avatar, at) == plain);
    avatar.view_color = {};
    CHECK(colours(avatar, at) == plain);
    check_neutral<float, More<OpticsEffects, ViewColor>, ViewColor>(0);
}

TEST_CASE("view color: a camera at a Gaussian gives it nothing, and finite gradients") {
    const TwoStream<double, Viewed> avatar = viewed_avatar<Viewed>();
    Drivers<double, Viewed> at = viewed_drivers<Viewed>();
    const Columns<double> plain =
        colours(restricted<PaperEffects>(avatar), restricted<PaperEffects>(at));
    at.camera = driven(avatar, at).gaussians.mean.col(3);
    const auto trace = driven(avatar, at);
    CHECK(trace.gaussians.feature.col(3) == plain.col(3));
    CHECK(trace.gaussians.feature.col(4) != plain.col(4));
    Gaussians<double> g = random_like(trace.gaussians, Random{5, 1});
    TwoStream<double, Viewed> grad = zeros_like(avatar);
    const Vec<double, 6> g_pose =
        drive_vjp(ScalarBackend<>{}, avatar, {tiny_config(), tiny_roles(), at}, trace, {g, grad});
    CHECK(g_pose.allFinite());
    CHECK(grad.view_color.face.allFinite());
    CHECK(grad.view_color.face.col(3).isZero(0));
    CHECK(grad.face.position.allFinite());
    at.camera[1] = std::numeric_limits<double>::quiet_NaN();
    CHECK_THROWS_WITH_AS(driven(avatar, at),
                         "view_color: got drivers without a camera, expected its centre in the "
                         "world",
                         Error);
}

TEST_CASE("view color: lanes and threads have the bits of a scalar backend") {
    const TwoStream<float, Viewed> avatar = lifted<float>(viewed_avatar<Viewed>());
    const auto at = viewed_drivers<Viewed>().cast<float>();
    const auto pass = [&](const auto& backend) {
        TwoStreamGaussians<float> t{driven(restricted<Viewed>(avatar), at).gaussians,
                                    avatar.face.position.cols()};
        Gaussians<float> g = random_like(t.gaussians, Random{5, 1});
        ViewColors<float> grad = zeros_like(avatar.view_color);
        const detail::SeenHead<float> seen{at.camera, so3_exp(Vec3<float>(at.pose.head<3>()))};
        add_view_colors(backend, avatar.view_color, seen, t.gaussians);
        const Mat3<float> r =
            view_colors_vjp(backend, avatar.view_color, seen, t.gaussians.mean, g, grad);
        Columns<float> all(1, t.gaussians.feature.size() + g.mean.size() + 9 + grad.face.size() +
                                  grad.eyes.size());
        all << t.gaussians.feature.reshaped().transpose(), g.mean.reshaped().transpose(),
            r.reshaped().transpose(), grad.face.reshaped().transpose(),
            grad.eyes.reshaped().transpose();
        return all;
    };
    const Columns<float> one = pass(ScalarBackend<Serial>{Serial{}});
    CHECK(one == pass(XsimdBackend<>{}));
    CHECK(one == pass(XsimdBackend{OpenMp{3}}));
}

TEST_CASE("view color: held without it, a face at rest and eyes keep what one camera sees") {
    using Still = Effects<HeadPose, LeftGaze, Kappa, HeadShading, Glint>;
    const TwoStream<double, Seen> all = viewed_avatar<Seen>();
    const Drivers<double, Seen> at = viewed_drivers<Seen>();
    const auto a = held<Still>(ScalarBackend<>{}, all, tiny_config(), tiny_roles(), at);
    // The face is kept but for its networks' attributes, whose rounding differs.
    CHECK((driven(a, restricted<Still>(at)).gaussians.feature - colours(all, at))
              .cwiseAbs()
              .maxCoeff() <= 1e-12);
    using With = More<Still, ViewColor>;
    const auto b = held<With>(ScalarBackend<>{}, all, tiny_config(), tiny_roles(), at);
    Drivers<double, Seen> aside = at;
    aside.camera[0] += 0.5;
    CHECK((driven(b, restricted<With>(aside)).gaussians.feature.leftCols(60) -
           colours(all, aside).leftCols(60))
              .cwiseAbs()
              .maxCoeff() <= 1e-12);
    CHECK_THROWS_AS(held<PaperEffects>(ScalarBackend<>{}, all, tiny_config(), tiny_roles(), at),
                    Error);
}

TEST_CASE("view color: other numbers of coefficients are refused") {
    TwoStream<double, Viewed> avatar = viewed_avatar<Viewed>();
    avatar.view_color.face = avatar.view_color.face.topRows(12).eval();
    CHECK_THROWS_WITH_AS(driven(avatar, viewed_drivers<Viewed>()),
                         "view_color: got 12 coefficients a Gaussian, expected 9, 24 or 45", Error);
}

static_assert(detail::is_absent<decltype(TwoStream<float>::view_color)>);
static_assert(sizeof(TwoStream<float, Viewed>) ==
              sizeof(TwoStream<float>) + sizeof(ViewColors<float>));
