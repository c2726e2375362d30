// SPDX-License-Identifier: Apache-2.0
#include <doctest/doctest.h>

#include "../support/step_law.hpp"

using namespace rye;
using namespace rye::test;

TEST_CASE("the two-stream step: its vjp is the transpose of its duals, in double") {
    for (const std::uint64_t seed : {1, 2, 3})
        CHECK(law_error<double>(SquaredDistance{}, seed) <= 1e-12);
    CHECK(law_error<double>(EuclideanDistance{}, 4) <= 1e-12);
}

TEST_CASE("a blink: without eye pixels the eye terms and their gradients are zero") {
    Draw draw;
    const AvatarConfig config = tiny_config();
    const TwoStream<double> avatar = tiny_avatar(config, draw);
    AvatarSample<double> sample = tiny_sample<double>(Draw{{9, 0}});
    sample.eyes.setZero();
    sample.eyes_small.setZero();
    const AvatarTraining<> training{.config = config, .roles = tiny_roles()};
    const Step<double> step = step_at(avatar, sample, training);
    const AvatarLosses<double>& l = step.losses;
    const AvatarPictures<double>& pictures = step.pictures;
    CHECK(l.eye_low == 0);
    CHECK(l.eye_high == 0);
    CHECK(l.blank == 0);
    CHECK(pictures.g_face.isZero(0));
    CHECK(pictures.g_eyes.isZero(0));
}

TEST_CASE("eyeball Gaussians are bounded by the template's spacing, and thinner along the normal") {
    Draw draw;
    EyeStream<double> eyes = tiny_avatar(tiny_config(), draw).eyes;
    eyes.log_scale.setZero();
    eyes.log_scale.col(1).setConstant(-20);
    detail::bound_scales(eyes, 0.7, 0.1);
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

namespace {

/// Pictures whose losses one can work out by hand: 8 x 4 pixels small, 16 x 8 large. All Gaussians
/// are transparent, so the final render and the eyes alone are the background b = (0.8, 0.6, 0.4),
/// the face alone is its own background c = (0.1, 0.3, 0.5), and super-resolution hands b on.
/// The small photograph is 0.2 everywhere; the large one 0.2 on its left half and 0.5 on its right.
struct ByHand {
    AvatarConfig config = tiny_config();
    TwoStream<double> avatar;
    AvatarSample<double> sample;
    AvatarLossConfig weights;
    AvatarPictures<double> pictures;

    ByHand() {
        Draw draw;
        avatar = tiny_avatar(config, draw);
        UpsamplerShape shape = avatar.upsampler.shape;
        shape.norm = Normalization::none;
        shape.skip = true;
        avatar.upsampler = Upsampler<double>(shape); // all zero: only the skip
        TwoStream<double>::fields([](const std::string& name, auto& a) {
            if (name.find("_mlp.") != std::string::npos) a.setZero();
        }, avatar);
        avatar.delta_pose.setZero();
        avatar.face.opacity_logit.setConstant(-1e3);
        avatar.eyes.opacity_logit.setConstant(-1e3);

        constexpr int w = 8, h = 4;
        AvatarSample<double>& s = sample;
        s.drivers = tiny_drivers<double>();
        s.camera = tiny_camera(w, h);
        s.truth_small = Image<double>(w, h, 3, 0.2);
        s.truth = Image<double>(2 * w, 2 * h, 3, 0.2);
        for (int y = 0; y < 2 * h; ++y)
            for (int x = w; x < 2 * w; ++x) s.truth.at(x, y).setConstant(0.5);
        // Padded: the large photograph's first column, two pixels of the small one.
        s.visible = Columns<double>::Ones(1, s.truth.size());
        for (int y = 0; y < 2 * h; ++y) s.visible(0, y * 2 * w) = 0;
        s.visible_small = Columns<double>::Ones(1, w * h);
        s.visible_small(0, 0) = s.visible_small(0, 1) = 0;
        s.eyes = Columns<double>::Zero(1, s.truth.size());
        for (int i = 0; i < 20; ++i) s.eyes(0, (i / 5) * 2 * w + w + i % 5) = 1; // right half
        show_small_eyes(10, 1);
        s.mask_small = Columns<double>::Constant(1, w * h, 0.75);
        s.background.resize(5);
        s.background << 0.8, 0.6, 0.4, 0.5, 0.5;
        s.blank.resize(5);
        s.blank << 0.1, 0.3, 0.5, 0.5, 0.5;
    }
    /// `count` pixels of the small eye mask, none of them padded.
    void show_small_eyes(Index count, double value) {
        sample.eyes_small = Columns<double>::Zero(1, sample.truth_small.size());
        sample.eyes_small.middleCols(12, count).setConstant(value);
    }
    AvatarLosses<double> losses() {
        const Step<double> step = step_at(
            avatar, sample,
            {.config = config, .roles = tiny_roles(), .objective = {.weights = weights}});
        pictures = step.pictures;
        return step.losses;
    }
};

doctest::Approx hand(double value) { return doctest::Approx(value).epsilon(1e-9); }

} // namespace

TEST_CASE("by hand: terms of the whole picture, without padded pixels, over all pixels") {
    ByHand b;
    const AvatarLosses<double> l = b.losses();
    // |b - 0.2| sums to 1.2 over the channels, |b - 0.5| to 0.5. Of 128 pixels 56 + 64 are seen.
    CHECK(l.high_resolution == hand((56 * 1.2 + 64 * 0.5) / (3 * 128)));
    CHECK(l.low_resolution == hand(30 * 1.2 / (3 * 32)));
    // One step of 0.3 in each row, among 15, 7 and 3 neighbours: the pyramid has no mask.
    CHECK(l.perceptual == hand(0.3 * (1.0 / 15 + 1.0 / 7 + 1.0 / 3)));
    CHECK(l.dssim == 0);
    CHECK(l.face_alone == 0); // weights of 0 by default
}

TEST_CASE("by hand: terms of the eyes, averaged over the picture") {
    ByHand b;
    const AvatarLosses<double> l = b.losses();
    CHECK(l.eye_low == hand(10 * 1.2 / (3 * 32)));
    CHECK(l.eye_high == hand(20 * 0.5 / (3 * 128)));
    CHECK(l.blank == 0); // a face that paints nothing leaves the background
    b.sample.eyes_high = false;
    CHECK(b.losses().eye_high == 0);
}

TEST_CASE("by hand: the face alone must be blank in the eyes") {
    ByHand b;
    // A black face before everything: each of the 10 pixels is off by 0.1 + 0.3 + 0.5.
    b.avatar.face.opacity_logit.setConstant(20);
    b.avatar.face.log_scale.setConstant(3);
    CHECK(b.losses().blank == doctest::Approx(10 * 0.9 / (3 * 32)).epsilon(1e-3));
}

TEST_CASE("by hand: the face alone beside the eyes") {
    ByHand b;
    b.weights.face_alone = 1;
    // A quarter of each pixel is not the head, there c replaces b in the photograph:
    // 0.2 + (c - b) / 4 = (0.025, 0.125, 0.225), from which c is off by 0.075 + 0.175 + 0.275.
    // 20 pixels are neither padded nor of an eye.
    CHECK(b.losses().face_alone == hand(20 * 0.525 / (3 * 32)));
}

TEST_CASE("by hand: the total, each term by its weight") {
    ByHand b;
    b.weights.high_resolution = 2, b.weights.low_resolution = 3, b.weights.perceptual = 5;
    b.weights.eye_low = 7, b.weights.eye_high = 11, b.weights.eye_high_every = 3;
    b.weights.face_alone = 13, b.weights.blank = 17;
    b.show_small_eyes(10, 0.5);
    const double high = 99.2 / 384, low = 36.0 / 96, pyramid = 0.3 * 57 / 105;
    const double eye_low = 10 * 0.6 / 96, eye_high = 10.0 / 384;
    const double face_alone = 10.5 / 96; // the face is transparent: nothing is off in the eyes
    CHECK(b.losses().total == hand(2 * high + 3 * low + 5 * pyramid + 7 * eye_low +
                                   33 * eye_high + 13 * face_alone));
    b.avatar.face.opacity_logit.setConstant(20); // a black face before everything
    b.avatar.face.log_scale.setConstant(3);
    const AvatarLosses<double> l = b.losses();
    b.weights.blank = 0;
    CHECK(l.blank > 0.01);
    CHECK(l.total - b.losses().total == hand(17 * l.blank));
}
