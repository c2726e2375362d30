// SPDX-License-Identifier: Apache-2.0
// Features of the eyes that the frame drives (rye/rig/driven_features.hpp) in a whole avatar.
#include <cmath>
#include <concepts>

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>

#include "../support/driven_eyes.hpp"

using namespace rye;
using namespace rye::test;

namespace {

/// By how much the features of the eyes differ between two drivers of an avatar.
template <EffectSet E>
double features_apart(const TwoStream<double, E>& avatar, const Drivers<double, E>& a,
                      const Drivers<double, E>& b) {
    const auto x = driven(avatar, a), y = driven(avatar, b);
    const Index n = x.eye_columns().count;
    return (x.gaussians.feature.rightCols(n) - y.gaussians.feature.rightCols(n))
        .cwiseAbs()
        .maxCoeff();
}

} // namespace

TEST_CASE("driven features: the vjp is the transpose of the duals") {
    CHECK(driven_law<More<AllEffects, Driven>>(1) <= 1e-12);
}

TEST_CASE("driven features: the gradient is that of central differences") {
    CHECK(difference_error(driven_eyes<More<AllEffects, Driven>>(7),
                           restricted<More<AllEffects, Driven>>(drivers_of_all()), 7) <= 1e-6);
}

TEST_CASE("driven features: a new avatar's equal the constants, to the bit") {
    const AvatarConfig config = tiny_config();
    const TwoStream<double> free = restricted<PaperEffects>(avatar_of_all());
    auto with = restricted<More<PaperEffects, Driven>>(free);
    CHECK(with.eyes.networks[0].weight.empty()); // constants alone
    const Drivers<double> at = tiny_drivers<double>();
    const auto equal = [&] {
        return driven(with, restricted<More<PaperEffects, Driven>>(at)).gaussians.feature ==
               driven(free, at).gaussians.feature;
    };
    CHECK(equal());
    const AppearanceSizes sizes =
        appearance_sizes<More<PaperEffects, Driven>>(config, with.eyes.position.cols());
    CHECK(sizes.pose == 6);
    with.eyes.networks = init_eye_appearance<DrivenFeatures, double>(sizes, Random{5, 0}).networks;
    CHECK_FALSE(with.eyes.networks[0].weight.empty());
    CHECK(equal());
    with.eyes.networks[1].bias.back()(0, 0) = 0.1;
    CHECK_FALSE(equal());
}

TEST_CASE("driven features: each driver changes them, and the other eye's gaze does not") {
    using E = More<PaperEffects, Driven>;
    const TwoStream<double, E> avatar = driven_eyes<E>(7);
    const Drivers<double, E> at = restricted<E>(tiny_drivers<double>());
    CHECK(features_apart(avatar, at, at) == 0);
    Drivers<double, E> other = at;
    other.expression[1] += 0.5;
    CHECK(features_apart(avatar, at, other) > 1e-3);
    other = at;
    other.pose[1] += 0.3;
    CHECK(features_apart(avatar, at, other) > 1e-3);
    other = at;
    other.pose[4] += 0.3; // a translation
    CHECK(features_apart(avatar, at, other) == 0);
    other = at;
    other.gaze[0] = Vec3<double>(-0.3, 0.2, 0.9);
    CHECK(features_apart(avatar, at, other) > 1e-3);
    const auto x = driven(avatar, at), y = driven(avatar, other);
    const Index right = avatar.eyes.points_of(1);
    CHECK(x.gaussians.feature.rightCols(right) == y.gaussians.feature.rightCols(right));
}

TEST_CASE("driven features: held, an avatar of constants shows them as at those drivers") {
    using E = More<PaperEffects, Driven>;
    const TwoStream<double, E> avatar = driven_eyes<E>(7);
    const Drivers<double, E> at = restricted<E>(tiny_drivers<double>());
    const auto held_there =
        held<PaperEffects>(ScalarBackend<>{}, avatar, tiny_config(), tiny_roles(), at);
    CHECK(driven(held_there, restricted<PaperEffects>(at)).gaussians.feature ==
          driven(avatar, at).gaussians.feature);
}

// An avatar of the default part has its size and fields.
static_assert(
    std::same_as<EyeAppearanceParameters<float, PaperEffects>, FreeFeatures::Parameters<float>>);
static_assert(sizeof(EyeStream<float, More<PaperEffects, Driven>>) ==
              sizeof(EyeStream<float>) + 2 * sizeof(Mlp<float>));
static_assert(detail::is_absent<decltype(detail::FrameCotangent<float, PaperEffects>::eye_pose)>);
