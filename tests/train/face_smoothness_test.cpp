// SPDX-License-Identifier: Apache-2.0
// Priors of the face's features (rye/train/face_smoothness.hpp), and their part in a step.
#include <rye/core/thread_pool.hpp>
#include <rye/splat/lanes.hpp>
#include <rye/train/avatar_trainer.hpp>

#include <doctest/doctest.h>

#include "../support/hostile.hpp"
#include "../support/random.hpp"
#include "../support/tiny_sample.hpp"

using namespace rye;
using namespace rye::test;

namespace {

AvatarLossConfig weights_of(double smooth, double mirror) {
    AvatarLossConfig w;
    w.face_smooth = smooth, w.face_mirror = mirror;
    return w;
}
AvatarTraining<> training_of(const AvatarLossConfig& weights, const FaceNeighbours& neighbours) {
    AvatarTraining<> t;
    t.config = tiny_config();
    t.roles = tiny_roles();
    t.objective.weights = weights;
    t.face_neighbours = neighbours;
    return t;
}

} // namespace

TEST_CASE("neighbours of the face: by a grid those of all pairs, with ties, on any threads") {
    Columns<float> line = Columns<float>::Zero(3, 40), same = Columns<float>::Ones(3, 7);
    for (Index i = 0; i < line.cols(); ++i) line(1, i) = static_cast<float>(i % 20);
    ThreadPool pool(3);
    for (const Columns<float>& points : {random_columns<float>(3, 1500, 4), line, same}) {
        const detail::NeighbourGraph graph =
            detail::four_nearest_by_grid(ScalarBackend<Serial>{}, points);
        CHECK(graph == detail::four_nearest(points));
        CHECK(graph == detail::four_nearest_by_grid(
                           ScalarBackend<ThreadPool::Handle>{pool.threads()}, points));
    }
    CHECK_FAULT(
        detail::four_nearest_by_grid(ScalarBackend<Serial>{}, Columns<float>(line.leftCols(4))),
        "got 4 points, expected at least 5");
}

TEST_CASE("neighbours of the face: the other side's, and its own where that is nearest") {
    Columns<double> points(3, 5);
    points << -1, 1.1, 0, 5, -2, //
        2, 2, 2, 2, 2,           //
        3, 3, 3, 3, 3;
    const detail::NeighbourGraph graph = mirrored_nearest(ScalarBackend<Serial>{}, points);
    CHECK(graph[0] == std::array<Index, 4>{1, 0, 0, 0});
    CHECK(graph[1] == std::array<Index, 4>{0, 1, 1, 1});
    CHECK(graph[2] == std::array<Index, 4>{2, 2, 2, 2});
    CHECK(graph[3] == std::array<Index, 4>{4, 3, 3, 3}); // mirrored beyond all points
    CHECK(graph[4] == std::array<Index, 4>{1, 4, 4, 4});
    const Columns<double> cloud = random_columns<double>(3, 900, 5);
    const detail::NeighbourGraph of_cloud = mirrored_nearest(ScalarBackend<Serial>{}, cloud);
    for (Index i = 0; i < cloud.cols(); ++i) {
        const Vec3<double> across(-cloud(0, i), cloud(1, i), cloud(2, i));
        Index nearest = 0;
        (cloud.colwise() - across).colwise().squaredNorm().minCoeff(&nearest);
        CHECK(of_cloud[static_cast<std::size_t>(i)][0] == nearest);
    }
    // Of values that differ by 1 across, and nowhere else: 2 squares, over 2 numbers.
    Columns<double> two(3, 2), values(1, 2);
    two << -1, 1, 0, 0, 0, 0;
    values << 0, 1;
    CHECK(smoothness(values, mirrored_nearest(ScalarBackend<Serial>{}, two)).value == 1);
}

TEST_CASE("priors of the face: gradients are those of differences, weights of 0 do nothing") {
    const Columns<double> points = random_columns<double>(3, 30, 6);
    Columns<double> values = random_columns<double>(4, 30, 7);
    for (const auto& w :
         {weights_of(0.7, 0), weights_of(0, 0.4), weights_of(0.7, 0.4), weights_of(0, 0)}) {
        const double smooth = w.face_smooth, mirror = w.face_mirror;
        CAPTURE(smooth);
        CAPTURE(mirror);
        const FaceNeighbours n = face_neighbours(ScalarBackend<Serial>{}, points, w);
        CHECK((n.near.empty() == (smooth == 0) && n.mirror.empty() == (mirror == 0)));
        const FaceSmoothness prior(w, n, points.cols());
        const auto total = [&](AvatarLosses<double>& l) {
            Columns<double> g = Columns<double>::Constant(4, 30, 0.5); // to which it is added
            l = {};
            prior.add(Serial{}, values, l, g);
            CHECK(l.total == doctest::Approx(smooth * l.face_smooth + mirror * l.face_mirror));
            return g;
        };
        AvatarLosses<double> here, more, less;
        const Columns<double> g = total(here);
        CHECK((here.face_smooth > 0) == (smooth > 0));
        CHECK((here.face_mirror > 0) == (mirror > 0));
        const double h = 1e-3; // of a square: differences are exact but for rounding
        for (Index i = 0; i < values.size(); i += 7) {
            const double was = values(i);
            values(i) = was + h, total(more);
            values(i) = was - h, total(less);
            values(i) = was;
            CHECK(std::abs(0.5 + (more.total - less.total) / (2 * h) - g(i)) < 1e-11);
        }
        if (smooth == 0 && mirror == 0) CHECK((g.array() == 0.5).all());
    }
}

TEST_CASE("priors of the face: in a step they add their gradient to the features' alone") {
    Draw draw;
    const TwoStream<double> start = tiny_avatar(tiny_config(), draw);
    const AvatarSample<double> sample = tiny_sample<double>(Draw{{9, 0}});
    const AvatarLossConfig on = weights_of(0.7, 0.4);
    const FaceNeighbours n = face_neighbours(ScalarBackend<Serial>{}, start.face.position, on);
    const auto stepped = [&](const AvatarLossConfig& weights, const FaceNeighbours& neighbours) {
        TwoStream<double> avatar = start;
        Adam<TwoStream<double>> adam(avatar);
        AvatarTrainer trainer{ScalarBackend<Serial>{}, avatar, adam,
                              training_of(weights, neighbours)};
        const AvatarLosses<double> losses = trainer.step(sample).losses;
        return std::pair{losses, adam.m};
    };
    const auto [losses, with] = stepped(on, n);
    const auto [plain, without] = stepped(AvatarLossConfig{}, {});
    CHECK((plain.face_smooth == 0 && plain.face_mirror == 0));
    AvatarLosses<double> own;
    Columns<double> g =
        Columns<double>::Zero(start.face.feature.rows(), start.face.feature.cols());
    FaceSmoothness(on, n, start.face.position.cols())
        .add(Serial{}, start.face.feature, own, g);
    CHECK(losses.face_smooth == own.face_smooth);
    CHECK(losses.face_mirror == own.face_mirror);
    CHECK(losses.total == doctest::Approx(plain.total + own.total).epsilon(1e-13));
    const Columns<double> added =
        (with.face.feature - without.face.feature) / (1 - AdamConfig{}.beta1);
    CHECK((added - g).norm() <= 1e-12 * g.norm());
    CHECK(with.face.position == without.face.position);
    CHECK(with.face.opacity_logit == without.face.opacity_logit);
    CHECK(with.eyes.feature == without.eyes.feature);
}

TEST_CASE("priors of the face: graphs that do not fit are refused") {
    Draw draw;
    TwoStream<double> avatar = tiny_avatar(tiny_config(), draw);
    Adam<TwoStream<double>> adam(avatar);
    const auto trainer = [&](const AvatarLossConfig& w, const FaceNeighbours& n) {
        AvatarTrainer{ScalarBackend<Serial>{}, avatar, adam, training_of(w, n)};
    };
    CHECK_FAULT(trainer(weights_of(0.5, 0), {}),
                "weights.face_smooth is 0.5 and its graph has 0 points, expected those of the");
    FaceNeighbours n;
    n.mirror.resize(3);
    CHECK_FAULT(trainer(weights_of(0, 1), n),
                "weights.face_mirror is 1 and its graph has 3 points");
    CHECK_NOTHROW(trainer(weights_of(0, 0), n));
}
