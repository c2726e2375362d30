// SPDX-License-Identifier: Apache-2.0
#include <rye/train/stage_avatar.hpp>

#include <doctest/doctest.h>

#include "tiny_avatar.hpp"

using namespace rye;
using namespace rye::test;

namespace {

template <class T>
AvatarSample<T> tiny_sample(Draw draw) {
    constexpr int w = 18, h = 14;
    const auto image = [&](int width, int height) {
        Image<T> i(width, height, 3);
        i.pixels = draw.columns(3, i.size(), 0.5).unaryExpr([](double x) { return T(x + 0.5); });
        return i;
    };
    AvatarSample<T> s;
    s.drivers = tiny_drivers<T>();
    s.frame = 1;
    s.camera = tiny_camera(w, h).cast<T>();
    s.truth = image(2 * w, 2 * h);
    s.truth_small = image(w, h);
    s.visible = Columns<T>::Ones(1, s.truth.size());
    s.visible_small = Columns<T>::Ones(1, s.truth_small.size());
    s.visible_small(0, 5) = T(0);
    s.eyes = Columns<T>::Zero(1, s.truth.size());
    s.eyes_small = Columns<T>::Zero(1, s.truth_small.size());
    for (Index i = 60; i < 90; ++i) s.eyes_small(0, i) = T(1);
    for (Index i = 300; i < 400; ++i) s.eyes(0, i) = T(1);
    s.mask_small = Columns<T>::Constant(1, s.truth_small.size(), T(0.75));
    s.scale = random_scale(w, h, 2, draw.random.fork(3));
    s.background = VecX<T>::Ones(5);
    s.blank = draw.columns(5, 1, 0.5).unaryExpr([](double x) { return T(x + 0.5); });
    return s;
}

template <class T, class U>
AvatarLosses<U> losses_at(const TwoStream<U>& avatar, const AvatarConfig& config,
                          EyeAverage average, bool blank_eyeballs, TwoStreamTrace<U>& trace,
                          AvatarPictures<U>& pictures) {
    AvatarLossConfig weights;
    weights.eye_average = average;
    weights.blank_eyeballs = blank_eyeballs;
    weights.face_alone = 0.7;
    weights.dssim = 0.3;
    return avatar_losses<ScalarBackend<>>(avatar, config, tiny_roles(), weights,
                                          Rasterizer<ScalarBackend<>, Balanced>{},
                                          PyramidGradientLoss{}, tiny_sample<U>(Draw{{9, 0}}), trace,
                                          pictures);
}

/// How far <gradient, d> is from the derivative along d that duals give.
template <class T>
double law_error(EyeAverage average, ChosenMetric metric, std::uint64_t seed,
                 bool blank_eyeballs = false) {
    using D = Dual<T, 1>;
    Draw draw{{seed, 3}};
    AvatarConfig config = tiny_config();
    config.metric = metric;
    const TwoStream<T> avatar = lifted<T>(tiny_avatar(config, draw));
    TwoStreamTrace<T> trace;
    AvatarPictures<T> pictures;
    const AvatarLosses<T> l = losses_at<T>(avatar, config, average, blank_eyeballs, trace, pictures);
    TwoStream<T> grad = zeros_like(avatar);
    avatar_losses_vjp<ScalarBackend<>>(avatar, config, Rasterizer<ScalarBackend<>, Balanced>{},
                                       tiny_sample<T>(Draw{{9, 0}}), trace, pictures, grad);
    const TwoStream<T> direction = random_like(avatar, Random{seed, 5});
    TwoStream<D> dual = lifted<D>(avatar);
    seed_fields(dual, avatar, direction);
    TwoStreamTrace<D> dual_trace;
    AvatarPictures<D> dual_pictures;
    const AvatarLosses<D> dl = losses_at<T>(dual, config, average, blank_eyeballs, dual_trace,
                                              dual_pictures);
    CHECK(std::abs(static_cast<double>(dl.total.value - l.total)) <=
          1e-5 * static_cast<double>(l.total));
    DotSum by_vjp, by_dual;
    by_vjp.add_all(grad, direction);
    by_dual.sum = static_cast<double>(dl.total.d[0]);
    CHECK(by_vjp.magnitude > 0.01);
    return disagreement(by_vjp, by_dual);
}

} // namespace

TEST_CASE("the two-stream step: its vjp is the transpose of its duals, in double") {
    for (const std::uint64_t seed : {1, 2, 3})
        CHECK(law_error<double>(EyeAverage::image, SquaredDistance{}, seed) <= 1e-12);
    CHECK(law_error<double>(EyeAverage::mask, EuclideanDistance{}, 4) <= 1e-12);
    CHECK(law_error<double>(EyeAverage::mask, SquaredDistance{}, 5, true) <= 1e-12);
}

TEST_CASE("the two-stream step: its vjp is the transpose of its duals, in float") {
    CHECK(law_error<float>(EyeAverage::image, SquaredDistance{}, 1) <= 1e-5);
    CHECK(law_error<float>(EyeAverage::mask, EuclideanDistance{}, 2) <= 1e-5);
    CHECK(law_error<float>(EyeAverage::mask, SquaredDistance{}, 3, true) <= 1e-5);
}

TEST_CASE("a blink: without eye pixels the eye terms and their gradients are zero") {
    Draw draw;
    const AvatarConfig config = tiny_config();
    const TwoStream<double> avatar = tiny_avatar(config, draw);
    AvatarSample<double> sample = tiny_sample<double>(Draw{{9, 0}});
    sample.eyes.setZero();
    sample.eyes_small.setZero();
    AvatarLossConfig weights;
    weights.eye_average = EyeAverage::mask;
    TwoStreamTrace<double> trace;
    AvatarPictures<double> pictures;
    const AvatarLosses<double> l = avatar_losses<ScalarBackend<>>(
        avatar, config, tiny_roles(), weights, Rasterizer<ScalarBackend<>, Balanced>{},
        PyramidGradientLoss{}, sample, trace, pictures);
    CHECK(l.eye_low == 0);
    CHECK(l.eye_high == 0);
    CHECK(l.blank == 0);
    CHECK(pictures.g_face.isZero(0));
    CHECK(pictures.g_eyes.isZero(0));
}

TEST_CASE("eyes from eye terms: their colours do not learn from the joint picture") {
    Draw draw;
    const AvatarConfig config = tiny_config();
    const TwoStream<double> avatar = tiny_avatar(config, draw);
    const AvatarSample<double> sample = tiny_sample<double>(Draw{{9, 0}});
    const auto gradient = [&](bool from_eye_terms, double joint) {
        AvatarLossConfig weights;
        weights.eyes_from_eye_terms = from_eye_terms;
        weights.high_resolution = weights.low_resolution = joint;
        weights.perceptual = 0;
        TwoStreamTrace<double> trace;
        AvatarPictures<double> pictures;
        const Rasterizer<ScalarBackend<>, Balanced> rasterizer;
        avatar_losses<ScalarBackend<>>(avatar, config, tiny_roles(), weights, rasterizer,
                                       PyramidGradientLoss{}, sample, trace, pictures);
        TwoStream<double> grad = zeros_like(avatar);
        avatar_losses_vjp<ScalarBackend<>>(avatar, config, rasterizer, sample, trace, pictures,
                                           grad);
        return grad;
    };
    const TwoStream<double> with = gradient(true, 1), without = gradient(false, 0);
    CHECK(with.eyes.feature.norm() > 0);
    CHECK(with.eyes.feature == without.eyes.feature);
    CHECK(with.eyes.log_scale == without.eyes.log_scale);
    CHECK(gradient(false, 1).eyes.feature != without.eyes.feature);
    CHECK(with.face.feature == gradient(false, 1).face.feature);
}

TEST_CASE("eyeball Gaussians are bounded by the template's spacing, and thinner along the normal") {
    Draw draw;
    EyeStream<double> eyes = tiny_avatar(tiny_config(), draw).eyes;
    eyes.log_scale.setZero();
    eyes.log_scale.col(1).setConstant(-20);
    bound_scales(eyes, 0.7, 0.1);
    const double most = 0.7 * eyes.spacing(0, 0);
    CHECK(std::exp(eyes.log_scale(0, 0)) == doctest::Approx(most));
    CHECK(std::exp(eyes.log_scale(1, 0)) == doctest::Approx(most));
    CHECK(std::exp(eyes.log_scale(2, 0)) == doctest::Approx(0.1 * most));
    CHECK(eyes.log_scale.col(1) == Vec3<double>::Constant(-20));
}

TEST_CASE("eye positions are the rig's: no field of the avatar moves them freely") {
    Draw draw;
    const TwoStream<double> avatar = tiny_avatar(tiny_config(), draw);
    TwoStream<double>::fields([](const std::string& name, const auto&) {
        CHECK(name != "eyes.xyz");
        CHECK(name != "eyes.centre");
    }, avatar);
}
