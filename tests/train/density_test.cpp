// SPDX-License-Identifier: Apache-2.0
#include <rye/train/density.hpp>

#include <numeric>

#include <doctest/doctest.h>

#include <rye/avatar/hold.hpp>
#include <rye/core/thread_pool.hpp>
#include <rye/splat/rasterizer.hpp>

#include "../support/hostile.hpp"
#include "../support/tiny_avatar.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using Shaded = More<PaperEffects, HeadShading, ViewColor>;

/// An avatar and moments of random numbers; those of its 60 Gaussians' positions are positive.
template <EffectSet E = PaperEffects>
struct Trained {
    TwoStream<double, E> avatar;
    Adam<TwoStream<double, E>> adam;

    Trained() {
        Draw draw;
        avatar = restricted<E>(tiny_avatar(tiny_config(), draw));
        if constexpr (has_effect<E, HeadShading>)
            avatar.shading = initial_shading<double>(draw.columns(3, 60));
        if constexpr (has_effect<E, ViewColor>)
            avatar.view_color = {draw.columns(9, 60), draw.columns(9, avatar.eyes.position.cols())};
        adam = Adam<TwoStream<double, E>>(avatar);
        adam.step = 70;
        TwoStream<double, E>::fields(
            [&](const std::string&, auto& m, auto& v) {
                m = draw.columns(m.rows(), m.cols());
                v = draw.columns(v.rows(), v.cols()).array().abs() + 0.01;
            },
            adam.m, adam.v);
    }
    Index count() const { return avatar.face.position.cols(); }
    bool operator==(const Trained& b) const {
        bool same = adam.step == b.adam.step;
        TwoStream<double, E>::fields(
            [&](const std::string&, const auto&... a) {
                const auto pair = [&](const auto& x, const auto& y) {
                    same = same && x.rows() == y.rows() && x.cols() == y.cols() && x == y;
                };
                const auto all = std::tie(a...);
                pair(std::get<0>(all), std::get<3>(all));
                pair(std::get<1>(all), std::get<4>(all));
                pair(std::get<2>(all), std::get<5>(all));
            },
            avatar, adam.m, adam.v, b.avatar, b.adam.m, b.adam.v);
        return same;
    }
};

/// Nobody is preferred, nobody goes.
DensityConfig even(double grow = 0.1) {
    DensityConfig c;
    c.every = 1;
    c.grow = grow;
    c.prune = 0;
    c.prefer = 1;
    return c;
}

const ScalarBackend<Serial> backend;

} // namespace

TEST_CASE("density: changes follow the steps that `every` divides, from the first to the last") {
    DensityConfig c;
    CHECK(next_density_step(c, 500) == std::numeric_limits<Index>::max());
    CHECK_FALSE(density_due(c, 500, 1000));
    CHECK(most_of_face(c, 100, 0, 1000) == 100);
    c.every = 20, c.first = 50, c.last = 100, c.grow = 0.5, c.most = 1000;
    std::vector<Index> due;
    for (Index step = 0; step <= 200; ++step)
        if (density_due(c, step, 200)) due.push_back(step);
    CHECK(due == std::vector<Index>{60, 80, 100});
    CHECK(next_density_step(c, 0) == 60);
    CHECK(next_density_step(c, 60) == 80);
    CHECK(next_density_step(c, 100) == std::numeric_limits<Index>::max());
    CHECK_FALSE(density_due(c, 80, 80)); // nothing is trained after it
    CHECK(most_of_face(c, 100, 0, 200) == doctest::Approx(337.5));
    CHECK(most_of_face(c, 100, 60, 200) == doctest::Approx(225));
    CHECK(most_of_face(c, 100, 0, 80) == doctest::Approx(150));
    CHECK(most_of_face(c, 500, 0, 200) == 1000);
    CHECK(most_of_face(c, 5000, 0, 200) == 5000);
    c.first = 0, c.every = 1, c.last = 1'000'000'000;
    CHECK_FALSE(density_due(c, 0, 200));
    CHECK(density_due(c, 1, 200));
    CHECK(most_of_face(c, 10, 0, 1'000'000'000) == 1000);
}

TEST_CASE("density: those of the largest gradients split, the first of equals, in their order") {
    Trained t;
    t.adam.v.face.position.setConstant(1);
    t.adam.v.face.position.col(40).setConstant(3);
    t.adam.v.face.position.col(7).setConstant(2);
    const Trained before = t;
    const DensityChange c = change_density(backend, t.avatar, t.adam, even());
    CHECK((c.grown == 6 && c.pruned == 0 && c.face == 66));
    const std::vector<Index> split{0, 1, 2, 3, 7, 40};
    Index at = 0;
    for (Index i = 0; i < before.count(); ++i) {
        const bool two = std::find(split.begin(), split.end(), i) != split.end();
        CAPTURE(i);
        for (Index k = at; k < at + (two ? 2 : 1); ++k) {
            CHECK(t.avatar.face.feature.col(k) == before.avatar.face.feature.col(i));
            CHECK(t.avatar.face.rotation.col(k) == before.avatar.face.rotation.col(i));
            const double mean = two ? 0.5 : 1;
            CHECK(t.adam.m.face.feature.col(k) == mean * before.adam.m.face.feature.col(i));
            CHECK(t.adam.v.face.log_scale.col(k) ==
                  mean * mean * before.adam.v.face.log_scale.col(i));
        }
        if (!two) {
            CHECK(t.avatar.face.position.col(at) == before.avatar.face.position.col(i));
            CHECK(t.avatar.face.opacity_logit(0, at) == before.avatar.face.opacity_logit(0, i));
        } else {
            const Vec3<double> middle =
                0.5 * (t.avatar.face.position.col(at) + t.avatar.face.position.col(at + 1));
            CHECK((middle - before.avatar.face.position.col(i)).norm() < 1e-15);
        }
        at += two ? 2 : 1;
    }
    CHECK(at == 66);
    CHECK(t.avatar.eyes.position == before.avatar.eyes.position);
    CHECK(t.adam.m.eyes.feature == before.adam.m.eyes.feature);
    CHECK(t.adam.step == 70);

    Trained full; // room for two
    DensityConfig few = even();
    few.most = 62;
    CHECK(change_density(backend, full.avatar, full.adam, few).face == 62);
    CHECK(change_density(backend, full.avatar, full.adam, few).grown == 0);
    few.most = 5; // there are more: none goes for it
    CHECK(change_density(backend, full.avatar, full.adam, few).face == 62);
    Trained faint; // halves of two would go
    DensityConfig pruned = even(1);
    pruned.prune = 0.1;
    faint.avatar.face.opacity_logit.setConstant(1);
    faint.avatar.face.opacity_logit(0, 8) = faint.avatar.face.opacity_logit(0, 9) = logit(0.11);
    CHECK(change_density(backend, faint.avatar, faint.adam, pruned).grown == 58);
    Trained still; // no picture has shown more than two
    still.adam.v.face.position.rightCols(58).setZero();
    CHECK(change_density(backend, still.avatar, still.adam, even()).grown == 2);
}

TEST_CASE("density: eyes and lips are preferred up to a distance") {
    Trained t;
    t.avatar.face.position.setConstant(50);
    t.avatar.face.position.col(3) = t.avatar.face.landmarks.col(40);
    t.avatar.face.position.col(4) =
        t.avatar.face.landmarks.col(60) + Vec3<double>(0, 0, 0.1); // others may be nearer
    t.avatar.face.position.col(5) = t.avatar.face.landmarks.col(3) - Vec3<double>(0, 0, 9);
    t.adam.v.face.position.setConstant(1);
    DensityConfig c = even();
    c.prefer = 3;
    c.reach = 0.4;
    const Columns<double> landmarks = t.avatar.face.landmarks.middleCols(36, 30);
    const std::vector<double> criterion = density_criterion<double>(
        backend, t.avatar.face.position, t.adam.v.face.position, landmarks, c);
    CHECK(criterion[3] == doctest::Approx(27));
    CHECK((criterion[4] >= 3 * 2.5 * 2.5 && criterion[4] <= 27));
    CHECK(criterion[5] == 3);
    CHECK(criterion[6] == 3);
    c.grow = 1.0 / 60;
    change_density(backend, t.avatar, t.adam, c);
    CHECK(t.avatar.face.feature.col(3) == t.avatar.face.feature.col(4)); // the first of equals
}

TEST_CASE("density: those that are hardly opaque go, with their normals and moments") {
    Trained<Shaded> t;
    t.avatar.face.opacity_logit(0, 0) = t.avatar.face.opacity_logit(0, 20) = -8;
    t.adam.v.face.position.col(20).setConstant(1e3); // goes all the same
    const Trained<Shaded> before = t;
    DensityConfig c = even(0);
    c.prune = 0.005;
    const DensityChange change = change_density(backend, t.avatar, t.adam, c);
    CHECK((change.grown == 0 && change.pruned == 2 && change.face == 58));
    CHECK(t.avatar.shading.normal.leftCols(19) == before.avatar.shading.normal.middleCols(1, 19));
    CHECK(t.avatar.shading.normal.rightCols(39) == before.avatar.shading.normal.rightCols(39));
    CHECK(t.adam.v.shading.normal.rightCols(39) == before.adam.v.shading.normal.rightCols(39));
    CHECK(t.avatar.shading.light == before.avatar.shading.light);
    const ViewColors<double>&now = t.avatar.view_color, &was = before.avatar.view_color;
    CHECK(now.face.leftCols(19) == was.face.middleCols(1, 19));
    CHECK(now.face.rightCols(39) == was.face.rightCols(39));
    CHECK(now.eyes == was.eyes);
    CHECK(t.adam.v.view_color.face.rightCols(39) == before.adam.v.view_color.face.rightCols(39));
    CHECK(t.adam.m.face.rotation.rightCols(39) == before.adam.m.face.rotation.rightCols(39));
    c.grow = 1;
    CHECK(change_density(backend, t.avatar, t.adam, c).face == 116);
    CHECK(t.avatar.shading.normal.cols() == 116);
    CHECK(now.face.cols() == 116);

    Trained gone;
    gone.avatar.face.opacity_logit.setConstant(-8);
    const Trained as_it_was = gone;
    CHECK_FAULT(change_density(backend, gone.avatar, gone.adam, c),
                "change_density: all 60 Gaussians of the face have an opacity below 0.005 "
                "(gaussians.density.prune), expected a face");
    CHECK(gone == as_it_was);
}

TEST_CASE("density: numbers that are not finite are refused, and nothing has changed") {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    const auto refused = [&](const auto& damage, const std::string& words) {
        Trained t;
        damage(t);
        CHECK_FAULT(change_density(backend, t.avatar, t.adam, even()), words);
        CHECK(t.count() == 60);
        CHECK(t.avatar.face.opacity_logit.cols() == 60);
    };
    refused([&](Trained<>& t) { t.avatar.face.position(1, 12) = nan; },
            "change_density: 'face.xyz' of Gaussian 12 is nan, expected a finite number");
    refused([&](Trained<>& t) { t.adam.m.face.feature(0, 3) = nan; },
            "the mean gradient of 'face.feature' of Gaussian 3 is nan");
    refused(
        [&](Trained<>& t) {
            t.adam.v.face.position(2, 59) = std::numeric_limits<double>::infinity();
        },
        "the mean square gradient of 'face.xyz' of Gaussian 59 is inf");
    refused([&](Trained<>& t) { t.adam.v.face.rotation(2, 5) = -1; },
            "the mean square gradient of 'face.rotation' of Gaussian 5 is -1, expected a "
            "finite number, 0 or more");
}

TEST_CASE("density: the same bits on any number of threads, by lanes and again") {
    const auto changed = [](const auto& on) {
        Trained t;
        DensityConfig c = even(0.3);
        c.prefer = 4;
        change_density(on, t.avatar, t.adam, c);
        return t;
    };
    const Trained once = changed(ScalarBackend<Serial>{});
    CHECK(once == changed(ScalarBackend<Serial>{}));
    ThreadPool pool(3);
    CHECK(once == changed(ScalarBackend<ThreadPool::Handle>{pool.threads()}));
}

TEST_CASE("density: a Gaussian splits along the axis on which moving it changes most") {
    const Mat3<double> turned =
        quat_matrix(quat_normalized(Quat<double>(std::sqrt(0.5), 0, 0, std::sqrt(0.5)))); // x to y
    const Vec3<double> round(0, 0, 0), square(1, 4, 2);
    CHECK(detail::split_axis<double>(Mat3<double>::Identity(), round, square) == 1);
    CHECK(detail::split_axis<double>(turned, round, square) == 0);
    CHECK(detail::split_axis<double>(Mat3<double>::Identity(), round, Vec3<double>(1, 1, 1)) == 0);
    CHECK(detail::split_axis<double>(Mat3<double>::Identity(), Vec3<double>(0, 0, 1),
                                     Vec3<double>(1, 1, 1)) == 2); // the longest
    CHECK(detail::split_axis<double>(Mat3<double>::Identity(), Vec3<double>(1, 0, 0), square) == 0);
}

TEST_CASE("density: halves absorb what the whole did") {
    for (const double a : {1e-6, 0.01, 0.3, 0.9, 0.999}) {
        const double half = sigmoid(detail::SplitGaussian::logit_opacity(logit(a)));
        CAPTURE(a);
        CHECK(std::log1p(-half) == doctest::Approx(detail::SplitGaussian::kappa * std::log1p(-a)));
        const float narrow = sigmoid(detail::SplitGaussian::logit_opacity(float(logit(a))));
        CHECK(narrow == doctest::Approx(half).epsilon(1e-5));
    }
    CHECK(std::isfinite(detail::SplitGaussian::logit_opacity(200.0f)));
    CHECK(std::isfinite(detail::SplitGaussian::logit_opacity(-80.0f)));
    // On a ray of low opacity: difference of the profiles over that of the whole.
    double apart = 0, all = 0, sums = 0, sum = 0;
    for (double x = -6; x <= 6; x += 0.01) {
        const auto profile = [](double z) { return std::exp(-z * z / 2); };
        const double s = 1 / detail::SplitGaussian::shrink, d = detail::SplitGaussian::distance;
        const double whole = profile(x), two = detail::SplitGaussian::kappa *
                                               (profile((x - d) / s) + profile((x + d) / s));
        apart += (two - whole) * (two - whole);
        all += whole * whole;
        sums += two;
        sum += whole;
    }
    CHECK(sums == doctest::Approx(sum));
    CHECK(std::sqrt(apart / all) < 0.12);
}

TEST_CASE("density: the picture hardly changes") {
    const auto picture = [](const Trained<>& t) {
        TwoStreamTrace<double> trace;
        const AvatarConfig config = tiny_config();
        drive(backend, t.avatar, {config, tiny_roles(), tiny_drivers<double>()}, trace);
        const Rasterizer<FeaturesOnly<Exact32>> rasterizer;
        const VecX<double> background = VecX<double>::Ones(config.channels);
        return rasterizer.forward(backend, trace.gaussians, tiny_camera(60, 48), background)
            .feature;
    };
    const auto rms = [](const Columns<double>& a) {
        return std::sqrt(a.squaredNorm() / static_cast<double>(a.size()));
    };
    const Trained before;
    const Image<double> was = picture(before);
    Image<double> blank = was;
    blank.pixels.setOnes();
    const double shown = rms(was.pixels - blank.pixels);
    Trained split = before;
    change_density(backend, split.avatar, split.adam, even(0.2));
    CHECK(split.count() == 72);
    const double apart = rms(picture(split).pixels - was.pixels);
    MESSAGE("of what is shown, splitting a fifth changes " << apart / shown);
    CHECK(apart > 0);
    CHECK(apart < 0.07 * shown);
    Trained all = before;
    change_density(backend, all.avatar, all.adam, even(1));
    CHECK(all.count() == 120);
    const double all_apart = rms(picture(all).pixels - was.pixels);
    MESSAGE("... splitting all " << all_apart / shown);
    CHECK(all_apart < 0.12 * shown);
}
