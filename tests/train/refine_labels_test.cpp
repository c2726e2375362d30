// SPDX-License-Identifier: Apache-2.0
// rye/train/refine_labels.hpp: labels of a frame by its photographs.
#include <rye/train/refine_labels.hpp>

#include <doctest/doctest.h>

#include <rye/autodiff/dual.hpp>
#include <rye/core/thread_pool.hpp>
#include <rye/splat/lanes.hpp>
#include <rye/train/host_label_drawing.hpp>

#include "../support/tiny_playable.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using Smooth = FeaturesOnly<Balanced>;
using Avatar = TrainedAvatar<double>;
using Labels = Drivers<double, TrainedEffects>;
constexpr double degree = 0.017453292519943295;

/// The tiny avatar; with a kappa, light and driven eyes if `whole`. No network reads `deaf`.
Avatar tiny_trained(bool whole, Index deaf = -1) {
    Draw draw;
    Avatar a = restricted<TrainedEffects>(tiny_avatar(tiny_config(), draw));
    if (whole) {
        a.eyes.kappa = Columns<double>::Constant(2, 2, 0.05);
        a.shading = {draw.columns(8, 3, 0.5), draw.columns(3, a.face.position.cols()),
                     draw.columns(3, 2)};
        const AppearanceSizes sizes =
            appearance_sizes<TrainedEffects>(tiny_config(), a.eyes.position.cols());
        for (Mlp<double>& mlp : a.eyes.networks)
            mlp = Mlp<double>::init(DrivenFeatures::shape(sizes), Random{9, draw.next++});
    }
    if (deaf < 0) return a;
    const Index e = tiny_config().expression;
    for (Mlp<double>* m :
         {&a.face.networks.exp_color, &a.face.networks.exp_deform, &a.face.exp_attributes})
        for (int l = 0; l < m->shape.layers(); ++l)
            if (m->shape.reads_input(l)) {
                Columns<double>& w = m->weight[static_cast<std::size_t>(l)];
                w.col(w.cols() - e + deaf).setZero();
            }
    Mlp<double>& offset = a.eyes.offset.mlp;
    for (int l = 0; l < offset.shape.layers(); ++l)
        if (offset.shape.reads_input(l))
            offset.weight[static_cast<std::size_t>(l)]
                .col(offset.shape.hidden_in(l) + deaf)
                .setZero();
    return a;
}

/// Cameras from the front and from both sides.
template <class T>
std::vector<Pinhole<T>> cameras(int side) {
    std::vector<Pinhole<T>> all;
    for (const double yaw : {-0.5, 0.0, 0.5}) {
        const Vec3<double> target(0, 0.2, 0.5);
        const Vec3<double> eye = target + 6 * gaze_vector(0.05, yaw);
        all.push_back(look_at<double>(eye, target, Vec3<double>(0, 1, 0), 0.42, {side, side})
                          .cast<T>());
    }
    return all;
}

/// Returns the avatar's pictures at the drivers.
template <class T, class B>
std::vector<LabelView<T>> photographs(const B& backend, const TrainedAvatar<T>& avatar,
                                      const Drivers<T, TrainedEffects>& drivers, int side) {
    const AvatarConfig config = tiny_config();
    const LandmarkRoles roles = tiny_roles();
    TwoStreamTrace<T, TrainedEffects> trace;
    drive(backend, avatar, {config, roles, drivers}, trace);
    Gaussians<T> g = trace.gaussians;
    g.feature = Columns<T>(g.feature.topRows(3));
    std::vector<LabelView<T>> views;
    for (const Pinhole<T>& camera : cameras<T>(side)) {
        LabelView<T> v;
        v.camera = camera;
        const VecX<T> background = v.background;
        v.truth = Rasterizer<Smooth>{}.forward(backend, g, camera, background).feature.pixels;
        v.weight = Columns<T>::Ones(1, v.truth.cols());
        views.push_back(v);
    }
    return views;
}

LabelUnknowns all_unknowns() {
    LabelUnknowns u;
    u.expression = {0, 1, 2};
    return u;
}

/// Labels as a tracker has them: gazes 4 degrees off, the head 0.6 degrees and 1 mm.
VecX<double> tracker_error() {
    VecX<double> e = VecX<double>::Zero(13);
    e << 4 * degree, 0, -2.5 * degree, 3 * degree, 0.4 * degree, -0.4 * degree, 0.2 * degree, 0.01,
        -0.006, 0.004, 0.06, -0.05, 0.04;
    return e;
}

} // namespace

TEST_CASE("refined labels: gazes 4 degrees off and a pose 0.6 degrees off are found again") {
    const AvatarConfig config = tiny_config();
    const LandmarkRoles roles = tiny_roles();
    const XsimdBackend backend;
    for (const bool whole : {false, true}) {
        const TrainedAvatar<float> avatar = lifted<float>(tiny_trained(whole));
        const auto truth = restricted<TrainedEffects>(tiny_drivers<float>());
        const auto views = photographs<float>(backend, avatar, truth, 96);
        const LabelUnknowns u = all_unknowns();
        const VecX<double> error = tracker_error();
        const auto label = moved_drivers(truth, u, error);
        HostLabelDrawing drawing(backend, avatar, config, roles);
        LabelRefiner refiner(backend.threads, drawing, u);
        const RefinedLabels r = refiner.refine(label, views);
        const VecX<double> left = r.change + error;
        CAPTURE(left.transpose());
        CAPTURE(r.sigma.transpose());
        CHECK(left.head(4).cwiseAbs().maxCoeff() < 0.01 * degree);
        CHECK(left.segment(4, 3).cwiseAbs().maxCoeff() < 0.001 * degree);
        CHECK(left.segment(7, 3).cwiseAbs().maxCoeff() < 1e-5);
        CHECK(left.tail(3).cwiseAbs().maxCoeff() < 1e-3);
        CHECK(r.cost < 0.01 * r.first_cost);
        CHECK(r.residual < 0.2 * r.first_residual);
        CHECK(r.steps >= 2);
        CHECK((r.sigma.array() < u.sigma().array()).all());
        MESSAGE("left " << left.head(4).cwiseAbs().maxCoeff() / degree << " deg of gaze, "
                        << left.segment(4, 3).cwiseAbs().maxCoeff() / degree << " deg of pose, "
                        << r.steps << " steps, residual " << r.first_residual << " to "
                        << r.residual);
    }
}

TEST_CASE("refined labels: columns of the Jacobian are those of duals through drive and render") {
    using D = Dual<double, 1>;
    const AvatarConfig config = tiny_config();
    const LandmarkRoles roles = tiny_roles();
    const ScalarBackend<> backend;
    const Avatar avatar = tiny_trained(true);
    const TwoStream<D, TrainedEffects> dual = lifted<D>(avatar);
    const Labels label = restricted<TrainedEffects>(tiny_drivers<double>());
    const LabelUnknowns u = all_unknowns();
    const auto views = photographs<double>(backend, avatar, label, 32);
    std::vector<Index> pixels;
    for (Index p = 0; p < views[0].truth.cols(); ++p) pixels.push_back(p);
    RefineSettings settings;
    settings.difference = 1e-6;
    HostLabelDrawing drawing(backend, avatar, config, roles);
    LabelRefiner refiner(backend.threads, drawing, u, settings);
    VecX<double> x = VecX<double>::Constant(u.count(), 0.3);
    const Columns<double> j = refiner.jacobian(label, views[0], pixels, x);
    const VecX<double> sigma = u.sigma();
    for (Index k = 0; k < u.count(); ++k) {
        Eigen::Matrix<D, Eigen::Dynamic, 1> change(u.count());
        for (Index i = 0; i < u.count(); ++i) {
            change[i].value = x[i] * sigma[i];
            change[i].d[0] = i == k ? sigma[i] : 0;
        }
        const Drivers<D, TrainedEffects> at = moved_drivers(label.cast<D>(), u, change);
        TwoStreamTrace<D, TrainedEffects> trace;
        drive(backend, dual, {config, roles, at}, trace);
        Gaussians<D> g = trace.gaussians;
        g.feature = Columns<D>(g.feature.topRows(3));
        const auto drawn = Rasterizer<Smooth>{}.forward(backend, g, views[0].camera.cast<D>(),
                                                        VecX<D>(VecX<D>::Ones(3)));
        double apart = 0, size = 0;
        for (Index p = 0; p < drawn.feature.pixels.cols(); ++p)
            for (Index c = 0; c < 3; ++c) {
                const double exact = drawn.feature.pixels(c, p).d[0];
                apart = std::max(apart, std::abs(exact - j(3 * p + c, k)));
                size = std::max(size, std::abs(exact));
            }
        CAPTURE(k);
        CHECK(size > 1e-3);
        CHECK(apart <= 1e-5 * size);
    }
}

TEST_CASE("refined labels: what moves no pixel stays at its label, with its prior's sigma") {
    const AvatarConfig config = tiny_config();
    const LandmarkRoles roles = tiny_roles();
    const ScalarBackend<> backend;
    const Avatar avatar = tiny_trained(false, 1);
    const Labels truth = restricted<TrainedEffects>(tiny_drivers<double>());
    LabelUnknowns u = all_unknowns();
    u.expression_sigma = 0.25;
    VecX<double> error = tracker_error();
    const auto views = photographs<double>(backend, avatar, truth, 48);
    HostLabelDrawing drawing(backend, avatar, config, roles);
    LabelRefiner refiner(backend.threads, drawing, u);
    const RefinedLabels r = refiner.refine(moved_drivers(truth, u, error), views);
    CHECK(r.change[11] == 0);
    CHECK(r.sigma[11] == doctest::Approx(0.25).epsilon(1e-9));
    CHECK(r.sigma[10] < 0.05);
    CHECK(std::abs(r.change[10] + error[10]) < 0.02);

    // Where the cameras look away nothing is determined.
    auto away = views;
    for (auto& v : away) v.camera.cx += 1000, v.truth.setOnes();
    const RefinedLabels none = refiner.refine(truth, away);
    CHECK(none.change.cwiseAbs().maxCoeff() == 0);
    CHECK((none.sigma - u.sigma()).cwiseAbs().maxCoeff() <= 1e-12);
}

TEST_CASE("refined labels: a narrow prior keeps its label") {
    const AvatarConfig config = tiny_config();
    const LandmarkRoles roles = tiny_roles();
    const ScalarBackend<> backend;
    const Avatar avatar = tiny_trained(false);
    const Labels truth = restricted<TrainedEffects>(tiny_drivers<double>());
    LabelUnknowns u = all_unknowns();
    u.gaze_sigma = 1e-7;
    const auto views = photographs<double>(backend, avatar, truth, 48);
    HostLabelDrawing drawing(backend, avatar, config, roles);
    LabelRefiner refiner(backend.threads, drawing, u);
    const RefinedLabels r = refiner.refine(moved_drivers(truth, u, tracker_error()), views);
    CHECK(r.change.head(4).cwiseAbs().maxCoeff() < 1e-4);
}

TEST_CASE("refined labels: the same bits for any number of threads") {
    const AvatarConfig config = tiny_config();
    const LandmarkRoles roles = tiny_roles();
    const TrainedAvatar<float> avatar = lifted<float>(tiny_trained(true));
    const auto truth = restricted<TrainedEffects>(tiny_drivers<float>());
    const LabelUnknowns u = all_unknowns();
    const auto label = moved_drivers(truth, u, tracker_error());
    const auto views = photographs<float>(XsimdBackend{}, avatar, truth, 64);
    const auto by_threads = [&](int threads) {
        ThreadPool pool(threads);
        const XsimdBackend<DefaultArch, ThreadPool::Handle> backend{pool.threads()};
        HostLabelDrawing drawing(backend, avatar, config, roles);
        LabelRefiner refiner(backend.threads, drawing, u);
        return refiner.refine(label, views);
    };
    const RefinedLabels one = by_threads(1), two = by_threads(2);
    CHECK((one.change.array() == two.change.array()).all());
    CHECK((one.sigma.array() == two.sigma.array()).all());
    CHECK(one.cost == two.cost);
}

TEST_CASE("refined labels: faults name what is wrong") {
    const AvatarConfig config = tiny_config();
    const LandmarkRoles roles = tiny_roles();
    const ScalarBackend<> backend;
    Avatar avatar = tiny_trained(false);
    const Labels truth = restricted<TrainedEffects>(tiny_drivers<double>());
    const auto message = [&](const LabelUnknowns& u, std::vector<LabelView<double>> views) {
        try {
            HostLabelDrawing drawing(backend, avatar, config, roles);
            LabelRefiner(backend.threads, drawing, u).refine(truth, views);
        } catch (const Error& e) {
            return std::string(e.what());
        }
        return std::string();
    };
    auto views = photographs<double>(backend, avatar, truth, 16);
    LabelUnknowns u = all_unknowns();
    u.expression = {3};
    CHECK(message(u, views).find("got expression coefficient 3, expected 0 to 2") !=
          std::string::npos);
    u = all_unknowns();
    auto blank = views;
    for (auto& v : blank) v.weight.setZero();
    CHECK(message(u, blank).find("no pixel whose weight is above 0") != std::string::npos);
    auto small = views;
    small[1].truth.resize(3, 4);
    CHECK(message(u, small).find("not the size of its camera") != std::string::npos);
    views[0].truth(0, 0) = std::numeric_limits<double>::quiet_NaN();
    CHECK(message(u, views).find("not finite") != std::string::npos);
    LabelUnknowns none;
    none.gaze = none.pose = false;
    CHECK(message(none, views).find("got no unknowns") != std::string::npos);
}
