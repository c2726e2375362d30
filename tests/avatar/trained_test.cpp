// SPDX-License-Identifier: Apache-2.0
// The avatar that a program trains and shows (rye/avatar/trained.hpp): what of it has no parameters
// changes nothing.
#include <rye/avatar/trained.hpp>

#include <algorithm>
#include <map>
#include <string>

#include <doctest/doctest.h>

#include <rye/backend/lanes.hpp>
#include <rye/core/bits.hpp>

#include "../support/avatar_law.hpp"
#include "../support/neutral_law.hpp"

using namespace rye;
using namespace rye::test;

namespace {

/// Bound of differences: compilers that may fuse products into sums choose which ones function by
/// function.
#if defined(__FMA__) || defined(__ARM_FEATURE_FMA)
constexpr double most_ulps = 64;
#else
constexpr double most_ulps = 0;
#endif

/// An avatar of all that is trained, none of it neutral.
TwoStream<double, TrainedEffects> avatar_of_trained(std::uint64_t seed = 7) {
    return avatar_with_parts<TrainedEffects>(seed);
}

template <EffectSet E, class T>
std::map<std::string, Columns<T>> fields_of(const TwoStream<T, E>& avatar) {
    std::map<std::string, Columns<T>> all;
    TwoStream<T, E>::fields([&](const std::string& name, const auto& a) { all[name] = a; }, avatar);
    return all;
}

/// The Gaussians of an avatar, and the gradients of a loss.
template <class T>
struct Pass {
    Gaussians<T> gaussians;
    std::map<std::string, Columns<T>> gradients;
    Vec<T, 6> pose;
};

template <class T, EffectSet E, class B>
Pass<T> pass_of(const B& backend, const TwoStream<T, E>& avatar, const Drivers<T>& drivers) {
    const AvatarConfig config = tiny_config();
    const LandmarkRoles roles = tiny_roles();
    const Drivers<T, E> own = seen_drivers<E>(drivers);
    TwoStreamTrace<T, E> trace;
    drive(backend, avatar, {config, roles, own}, trace);
    Gaussians<T> g = random_like(trace.gaussians, Random{5, 1});
    TwoStream<T, E> grad = zeros_like(avatar);
    const Vec<T, 6> pose = drive_vjp(backend, avatar, {config, roles, own}, trace, {g, grad});
    return {trace.gaussians, fields_of(grad), pose};
}

template <class T>
bool alike(const Gaussians<T>& a, const Gaussians<T>& b) {
    bool same = true;
    Gaussians<T>::fields(
        [&](const std::string&, const auto& x, const auto& y) { same = same && same_bits(x, y); },
        a, b);
    return most_ulps == 0 ? same : ulps(a, b) <= most_ulps;
}

template <class T>
bool alike(const Columns<T>& a, const Columns<T>& b) {
    const T bound = T(most_ulps) * std::numeric_limits<T>::epsilon();
    return a.rows() == b.rows() && a.cols() == b.cols() &&
           (a.size() == 0 ||
            (a - b).cwiseAbs().maxCoeff() <= bound * std::max(T(1), a.cwiseAbs().maxCoeff()));
}

template <class T, class B>
void check_neutral_parts(const B& backend) {
    const TwoStream<T> paper = lifted<T>(restricted<PaperEffects>(avatar_of_all()));
    TwoStream<T, TrainedEffects> avatar = restricted<TrainedEffects>(paper);
    CHECK(avatar.eyes.kappa.size() == 0);
    CHECK_FALSE(avatar.shading.any());
    CHECK_FALSE(avatar.has_view_color());
    CHECK_FALSE(has_driven_eyes(avatar));
    for (const double turn : {0.0, 0.4}) {
        Drivers<T> drivers = tiny_drivers<T>();
        drivers.pose[1] += T(turn);
        drivers.gaze[1] *= T(1.7); // of any length
        const Pass<T> a = pass_of(backend, avatar, drivers), b = pass_of(backend, paper, drivers);
        CHECK(alike(a.gaussians, b.gaussians));
        REQUIRE(a.gradients.size() == b.gradients.size());
        for (const auto& [name, gradient] : b.gradients) {
            REQUIRE_MESSAGE(a.gradients.count(name) == 1, name);
            CHECK_MESSAGE(alike(a.gradients.at(name), gradient), name);
        }
        CHECK(alike(Columns<T>(a.pose), Columns<T>(b.pose)));
    }
}

} // namespace

TEST_CASE(
    "a trained avatar without kappa, light and driven eyes is the paper's, and so are its "
    "gradients") {
    check_neutral_parts<double>(ScalarBackend<>{});
    check_neutral_parts<float>(XsimdBackend<>{});
}

TEST_CASE("each part of a trained avatar shows, and an angle of 0 is no angle") {
    const Drivers<double> drivers = tiny_drivers<double>();
    const auto look = [&](const auto& a) {
        return driven(a, seen_drivers<TrainedEffects>(drivers)).gaussians;
    };
    const auto all = avatar_of_trained();
    CHECK(has_driven_eyes(all));
    auto none = all;
    none.eyes.kappa = {};
    none.shading = {};
    none.view_color = {};
    none.eyes.networks = {};
    none.eyes.optics = {};
    const Gaussians<double> plain = look(none);
    auto one = none;
    one.eyes.kappa = all.eyes.kappa;
    CHECK_FALSE(alike(look(one), plain));
    one.eyes.kappa.setZero();
    CHECK(alike(look(one), plain));
    one = none;
    one.eyes.optics = all.eyes.optics;
    CHECK_FALSE(alike(look(one), plain));
    one.eyes.optics.light_intensity.setZero();
    CHECK_FALSE(alike(look(one), plain));
    one.eyes.optics.index.setOnes();
    CHECK(alike(look(one), plain));
    one.eyes.optics = all.eyes.optics;
    one.eyes.optics.index = {};
    CHECK_FALSE(alike(look(one), plain));
    CHECK(look(one).mean == plain.mean);
    one = none;
    one.shading = all.shading;
    CHECK_FALSE(alike(look(one), plain));
    one = none;
    one.view_color = all.view_color;
    CHECK_FALSE(alike(look(one), plain));
    one = none;
    one.eyes.networks[0] = all.eyes.networks[0];
    CHECK(has_driven_eyes(one));
    const Gaussians<double> left = look(one);
    CHECK_FALSE(alike(left, plain));
    CHECK(left.feature.rightCols(one.eyes.points_of(1)) ==
          plain.feature.rightCols(one.eyes.points_of(1)));
}

TEST_CASE("a trained avatar's vjp is the transpose of its duals, whatever has no parameters") {
    const auto drivers = seen_drivers<TrainedEffects>(tiny_drivers<double>());
    for (int on = 0; on < 64; ++on) {
        INFO(on);
        auto a = avatar_of_trained();
        if ((on & 1) == 0) a.eyes.kappa = {};
        if ((on & 2) == 0) a.shading = {};
        if ((on & 4) == 0) a.eyes.networks = {};
        if ((on & 8) == 0) resize_lights(a.eyes.optics, 0);
        if ((on & 16) == 0) a.eyes.optics.index = {};
        if ((on & 32) == 0) a.view_color = {};
        CHECK(law_error<TrainedEffects>(a, drivers, 3) <= 1e-12);
    }
}

TEST_CASE("held with fewer effects a trained avatar looks the same, highlights drawn or kept") {
    const auto drivers = seen_drivers<TrainedEffects>(tiny_drivers<double>());
    for (const bool lit : {true, false}) {
        INFO(lit);
        auto all = avatar_of_trained();
        if (!lit) all.eyes.optics = {};
        all.view_color = {};
        const auto right = driven(all, drivers);
        const auto gap = [&]<EffectSet Fewer>(Fewer) {
            const auto a =
                held<Fewer>(ScalarBackend<>{}, all, tiny_config(), tiny_roles(), drivers);
            const auto seen = driven(a, restricted<Fewer>(drivers));
            double most = 0;
            Gaussians<double>::fields([&](const std::string&, const auto& p, const auto& q) {
                most = std::max(most, (p - q).cwiseAbs().maxCoeff());
            }, copy_of(seen.eye_gaussians()), copy_of(right.eye_gaussians()));
            return most;
        };
        CHECK(gap(Less<TrainedEffects, Glint>{}) <= 1e-12);
        using Straight = Less<TrainedEffects, CornealRefraction, Pupil>;
        if (lit)
            CHECK_THROWS_AS(gap(Straight{}), Error);
        else
            CHECK(gap(Straight{}) <= 1e-12);
        CHECK(gap(Less<Straight, LidShadow, EyesBy<DrivenFeatures>>{}) <= 1e-12);
        CHECK(gap(Less<TrainedEffects, PoseResidual>{}) <= 1e-12);
        CHECK(gap(Effects<HeadPose, CornealBulge, Glint, HeadShading>{}) <= 1e-12);
        CHECK(gap(Effects<HeadPose, CornealBulge, HeadShading>{}) <= 1e-12);
        CHECK(gap(Effects<HeadPose, LeftGaze, RightGaze, Kappa, Periocular, CornealBulge,
                          CornealRefraction, Glint, HeadShading, EyesBy<DrivenFeatures>>{}) <=
              1e-12);
    }
}

TEST_CASE("tensors of a trained avatar have a checkpoint's names; what is off has none") {
    auto a = avatar_of_trained();
    const auto all = fields_of(a);
    for (const char* name :
         {"eyes.feature", "eyes.kappa", "eyes.left_appearance_mlp.conv0.weight",
          "eyes.right_appearance_mlp.conv2.bias", "eyes.light_position", "eyes.light_intensity",
          "eyes.refractive_index", "eyes.lid_shadow", "shading.light", "shading.normal",
          "shading.eye_normal", "view_color.face", "view_color.eyes"})
        CHECK_MESSAGE(all.count(name) == 1, name);
    a.eyes.kappa = {};
    a.shading = {};
    a.view_color = {};
    a.eyes.networks = {};
    a.eyes.optics = {};
    a.eyes.lid_shadow = a.eyes.lid_line = {};
    const auto paper = fields_of(restricted<PaperEffects>(a));
    const auto left = fields_of(a);
    CHECK(left.size() == paper.size());
    CHECK(std::equal(left.begin(), left.end(), paper.begin(),
                     [](const auto& x, const auto& y) { return x.first == y.first; }));
}

TEST_CASE("an eye's driven features are written alone, and are those of both") {
    const auto a = avatar_of_trained();
    const OpticalDrivers<double, TrainedEffects> drivers(
        seen_drivers<TrainedEffects>(tiny_drivers<double>()));
    const FrameCode<double, TrainedEffects> code = frame_code(tiny_config(), drivers);
    Columns<double> both(5, a.eyes.position.cols()), alone = both;
    alone.setConstant(-1);
    static_assert(EyeByEye<DrivenFeatures> && !EyeByEye<FreeFeatures>);
    detail::with_eye_inputs(a.eyes, drivers, code, [&](const EyeInputs<double>& inputs) {
        DrivenFeatures::features(ScalarBackend<>{}, a.eyes.appearance(), inputs,
                                 ColumnsSpan<double>(both));
        DrivenFeatures::eye_features(ScalarBackend<>{}, a.eyes.appearance(), inputs, 1,
                                     ColumnsSpan<double>(alone));
    });
    const Index left = a.eyes.points_of(0), right = a.eyes.points_of(1);
    CHECK((alone.leftCols(left).array() == -1).all());
    CHECK(alone.rightCols(right) == both.rightCols(right));
}
