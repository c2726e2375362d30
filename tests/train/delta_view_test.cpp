// SPDX-License-Identifier: Apache-2.0
// Corrections of cameras' poses (TwoStream::delta_view) that a training of stage 2 makes.
#include <Eigen/Geometry>

#include <rye/splat/lanes.hpp>
#include <rye/train/avatar_trainer.hpp>

#include <doctest/doctest.h>

#include <limits>
#include <utility>
#include <vector>

#include "../support/corrected_avatar.hpp"
#include "../support/hostile.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using E = TrainedEffects;
constexpr Index cameras = corrected_cameras;

template <class T>
SeenBy<T> seen(Index column) {
    return {column, Vec3<T>(T(0.3), T(-0.2), T(0.5))};
}

} // namespace

TEST_CASE("corrected cameras: their gradient is the transpose of their duals") {
    using D = Dual<double, 1>;
    const TwoStream<double, E> avatar = corrected_avatar();
    auto sample = tiny_sample<double, E>(Draw{{9, 0}});
    sample.view = seen<double>(1);
    TwoStream<double, E> own = avatar, gradient = zeros_like(avatar);
    Adam<TwoStream<double, E>> adam(own);
    AvatarTrainer trainer{ScalarBackend<Serial>{}, own, adam, training_of_corrections()};
    trainer.losses(sample.drivers, sample);
    trainer.add_gradient(sample.drivers, sample, gradient);
    Draw draw{{4, 1}};
    const Columns<double> of_view = draw.columns(6, cameras), of_pose = draw.columns(6, 1);
    TwoStream<D, E> dual = lifted<D>(avatar);
    for (Index i = 0; i < of_view.size(); ++i) dual.delta_view.data()[i].d[0] = of_view.data()[i];
    for (Index i = 0; i < 6; ++i) dual.delta_pose(i, sample.frame).d[0] = of_pose(i);
    Adam<TwoStream<D, E>> dual_adam(dual);
    AvatarTrainer dual_trainer{ScalarBackend<Serial>{}, dual, dual_adam, training_of_corrections()};
    auto dual_sample = tiny_sample<D, E>(Draw{{9, 0}});
    dual_sample.view = seen<D>(1);
    const double by_dual = dual_trainer.losses(dual_sample.drivers, dual_sample).total.d[0];
    const double by_vjp = gradient.delta_view.cwiseProduct(of_view).sum() +
                          gradient.delta_pose.col(sample.frame).dot(of_pose.col(0));
    CHECK(std::abs(by_dual) > 1e-4);
    CHECK(std::abs(by_dual - by_vjp) <= 1e-10 * std::abs(by_dual));
    CHECK(gradient.delta_view.col(0).isZero(0)); // the sample is of camera 1
    CHECK(gradient.delta_view.col(2).isZero(0));
    CHECK(!gradient.delta_view.col(1).isZero(0));
}

TEST_CASE("corrected cameras: a moved head is seen as by the camera that is moved back") {
    const ScalarBackend<Serial> backend;
    const TwoStream<double, E> avatar = corrected_avatar();
    const auto sample = tiny_sample<double, E>(Draw{{9, 0}});
    const auto drawn = [&](const SeenBy<double>& view, const Pinhole<double>& camera) {
        TwoStreamTrace<double, E> trace;
        drive(backend, avatar, {tiny_config(), tiny_roles(), sample.drivers, view}, trace);
        return Rasterizer<FeaturesOnly<Exact64>>{}
            .forward(backend, trace.gaussians, camera, sample.background)
            .feature.pixels;
    };
    const Pinhole<double> camera = tiny_camera(24, 18);
    const Columns<double> unmoved = drawn({}, camera);
    for (Index k = 0; k < cameras; ++k) {
        CAPTURE(k);
        const SeenBy<double> view = seen<double>(k);
        const Columns<double> moved = drawn(view, camera);
        const Columns<double> from =
            drawn({}, seen_camera<double>(camera, avatar.delta_view.col(k), view.pivot));
        CHECK((moved - from).cwiseAbs().maxCoeff() <= 1e-9);
        CHECK((moved - unmoved).cwiseAbs().maxCoeff() >= 1e-2);
    }
}

TEST_CASE("corrected cameras: what they share is what their pictures show alike") {
    // A camera from the front, one from each side; the motion of the head along the first one's
    // line of sight shows in the others alone.
    Columns<double> directions(3, 3);
    directions << 0, 1, -1, 0, 0, 0, 1, 0, 0;
    const Columns<double> gauge = detail::view_gauge(directions);
    Columns<double> same = Draw{{2, 2}}.columns(6, 1, 0.1).replicate(1, 3);
    detail::centre_views(gauge, same);
    CHECK(same.cwiseAbs().maxCoeff() <= 1e-6); // a motion of all is nothing of any
    Columns<double> seen = Columns<double>::Zero(6, 3), along = seen;
    seen(5, 1) = seen(5, 2) = 0.1;
    detail::centre_views(gauge, seen); // the first camera could not have seen it
    CHECK(seen.middleCols(1, 2).cwiseAbs().maxCoeff() <= 1e-6);
    CHECK(std::abs(seen(5, 0) + 0.1) <= 1e-6);
    along(5, 0) = 0.1;
    const Columns<double> before = along;
    detail::centre_views(gauge, along); // what no other camera shows stays its own
    CHECK((along - before).cwiseAbs().maxCoeff() <= 1e-12);
    // All look the same way: along it nothing is shared.
    const Columns<double> one = Vec3<double>::UnitZ().replicate(1, 3);
    Columns<double> apart = Columns<double>::Zero(6, 3);
    apart.row(5).setConstant(0.2), apart.row(3).setConstant(0.3);
    detail::centre_views(detail::view_gauge(one), apart);
    CHECK((apart.row(5).array() == 0.2).all());
    CHECK(apart.row(3).cwiseAbs().maxCoeff() <= 1e-6);
}

TEST_CASE("corrected cameras: a stretch of the head is nothing of any of six") {
    Draw draw{{3, 4}};
    for (const bool flat : {false, true}) { // flat: all in a plane, which hides two stretches
        CAPTURE(flat);
        Columns<double> directions = draw.columns(3, 7, 1.0);
        if (flat) directions.row(1).setZero();
        directions.colwise().normalize();
        const Columns<double> gauge = detail::view_gauge(directions);
        CHECK(gauge.cols() == 22);
        const Mat3<double> any = draw.columns(3, 3, 0.1);
        const Mat3<double> stretch = any + any.transpose();
        Columns<double> views = Columns<double>::Zero(6, 7);
        for (Index c = 0; c < 7; ++c) // the rotation that shows it best across the line of sight
            views.col(c).head<3>() =
                Vec3<double>(directions.col(c)).cross(Vec3<double>(stretch * directions.col(c)));
        CHECK(views.cwiseAbs().maxCoeff() > 0.02);
        detail::centre_views(gauge, views);
        CHECK(views.cwiseAbs().maxCoeff() <= 1e-6);
        Columns<double> own = draw.columns(6, 7, 0.1);
        detail::centre_views(gauge, own);
        CHECK(own.cwiseAbs().maxCoeff() > 0.02); // each has some of its own
        const Columns<double> once = own;
        detail::centre_views(gauge, own);
        CHECK((own - once).cwiseAbs().maxCoeff() <= 1e-6);
    }
    const Columns<double> few = Draw{{5, 6}}.columns(3, 5, 1.0).colwise().normalized();
    CHECK(detail::view_gauge(few).cols() == 12);
}

TEST_CASE("corrected cameras: steps that are applied take off what they share; faults") {
    const Columns<double> gauge = detail::view_gauge(training_of_corrections().view_directions);
    const auto off = [&](Columns<double> a) {
        const Columns<double> before = a;
        detail::centre_views(gauge, a);
        return (a - before).cwiseAbs().maxCoeff();
    };
    auto sample = tiny_sample<double, E>(Draw{{9, 0}});
    sample.view = seen<double>(2);
    AvatarTraining<> t = training_of_corrections();
    t.rates.delta_view = 1e-4;
    TwoStream<double, E> avatar = corrected_avatar();
    Adam<TwoStream<double, E>> adam(avatar);
    AvatarTrainer trainer{ScalarBackend<Serial>{}, avatar, adam, t};
    double& bias = avatar.upsampler.out_bias(1, 0);
    const double finite = std::exchange(bias, std::numeric_limits<double>::quiet_NaN());
    CHECK(!trainer.step(sample).adam.applied);
    bias = finite;
    CHECK(avatar.delta_view == corrected_avatar().delta_view);
    CHECK(off(avatar.delta_view) > 1e-3);
    const Columns<double> apart = avatar.delta_view.col(2) - avatar.delta_view.col(0);
    CHECK(trainer.step(sample).adam.applied);
    CHECK(off(avatar.delta_view) <= 1e-7); // the gauge is not exactly a projection
    const Columns<double> now = avatar.delta_view.col(2) - avatar.delta_view.col(0);
    CHECK((now - apart).cwiseAbs().maxCoeff() <= 2.1e-4); // a step of Adam
    CHECK(!(now == apart));

    for (const double length : {1.0, 2.0}) {
        AvatarTraining<> bad = training_of_corrections();
        if (length == 1.0) bad.view_directions.resize(3, 2);
        else bad.view_directions *= length;
        CHECK_FAULT((AvatarTrainer{ScalarBackend<Serial>{}, avatar, adam, bad}),
                    length == 1.0 ? "view_directions is 3 x 2, expected 3 x 3"
                                  : "column 0 of view_directions has length 2, expected 1");
    }
    TwoStream<double, E> wrong = corrected_avatar();
    wrong.delta_view.resize(5, 3);
    CHECK_FAULT((AvatarTrainer{ScalarBackend<Serial>{}, wrong, adam, training_of_corrections()}),
                "delta_view has 5 rows, expected 6");
}

TEST_CASE("corrected cameras: wrong ones come back") {
    TwoStream<double, E> truth = corrected_avatar();
    truth.delta_view.setZero();
    truth.delta_pose.setZero();
    // Rotations of up to a degree, shifts of up to 2 % of the unit, 0 on average.
    Columns<double> error(6, cameras);
    error << 0.015, -0.01, -0.005, 0.01, 0.005, -0.015, -0.01, 0.015, -0.005, //
        0.02, -0.01, -0.01, -0.01, 0.02, -0.01, 0.01, 0.01, -0.02;
    std::vector<AvatarSample<double, E>> samples;
    for (Index k = 0; k < cameras; ++k) {
        auto s = tiny_sample<double, E>(Draw{{9, 0}});
        s.frame = -1;
        s.view = seen<double>(k);
        s.camera = tiny_camera(24, 18);
        draw_truth(truth, s);
        // The label: the camera after the error, which the correction must take back.
        s.camera = seen_camera<double>(s.camera, error.col(k), s.view.pivot);
        samples.push_back(s);
    }
    TwoStream<double, E> avatar = truth;
    Adam<TwoStream<double, E>> adam(avatar);
    AvatarTraining<> t = training_of_nothing();
    t.rates.delta_view = 1e-3;
    const Vec3<double> from = tiny_camera(24, 18).centre() - seen<double>(0).pivot;
    t.view_directions = from.normalized().replicate(1, cameras); // all are one camera
    AvatarTrainer trainer{ScalarBackend<Serial>{}, avatar, adam, t};
    const auto loss = [&] {
        double sum = 0;
        for (const auto& s : samples) sum += trainer.losses(s.drivers, s).total;
        return sum;
    };
    const double wrong = loss();
    avatar.delta_view = -error; // to first order
    CHECK(loss() < 0.05 * wrong);
    avatar.delta_view.setZero();
    for (Index step = 0; step < 240; ++step) {
        const auto& s = samples[static_cast<std::size_t>(step % cameras)];
        trainer.step(s.drivers, s, step < 150 ? 1 : 0.2);
    }
    CAPTURE(avatar.delta_view);
    CHECK(loss() < 0.1 * wrong);
}
