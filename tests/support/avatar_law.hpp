// SPDX-License-Identifier: Apache-2.0
/// tests/support/avatar_law.hpp: an avatar's vjp against its duals, for any list of effects.
#pragma once

#include <cmath>

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>

#include "effect_sets.hpp"

namespace rye::test {

/// Disagreement of <vjp, direction> with duals, for one random direction of all parameters and of
/// the head pose.
template <EffectSet E>
double law_error(const TwoStream<double, E>& avatar, const Drivers<double, E>& drivers,
                 std::uint64_t seed) {
    using D = Dual<double, 1>;
    const AvatarConfig config = tiny_config();
    TwoStreamTrace<double, E> trace;
    drive(ScalarBackend<>{}, avatar, {config, tiny_roles(), drivers}, trace);
    const Gaussians<double> w = random_like(trace.gaussians, Random{seed, 1});
    Gaussians<double> g = w;
    TwoStream<double, E> grad = zeros_like(avatar);
    const Vec<double, 6> g_pose =
        drive_vjp(ScalarBackend<>{}, avatar, {config, tiny_roles(), drivers}, trace, {g, grad});

    const TwoStream<double, E> direction = random_like(avatar, Random{seed, 3});
    const Columns<double> pose_direction = random_columns<double>(6, 1, Random{seed, 4});
    TwoStream<D, E> dual = lifted<D>(avatar);
    detail::seed_fields(dual, avatar, direction);
    Drivers<D, E> dual_drivers = drivers.template cast<D>();
    if constexpr (has_effect<E, ReadsHeadPose>)
        dual_drivers.pose = detail::seeded(Columns<double>(drivers.pose), pose_direction);
    TwoStreamTrace<D, E> dual_trace;
    drive(ScalarBackend<>{}, dual, {config, tiny_roles(), dual_drivers}, dual_trace);
    DotSum by_vjp, by_dual;
    by_vjp.add_all(grad, direction);
    if constexpr (has_effect<E, ReadsHeadPose>) by_vjp.add(g_pose, pose_direction);
    Gaussians<double> d = w;
    Gaussians<double>::fields([](const std::string&, auto& to, const auto& from) {
        to = from.unaryExpr([](const D& x) { return x.d[0]; });
    }, d, dual_trace.gaussians);
    by_dual.add_all(d, w);
    CHECK(by_vjp.magnitude > 0.01);
    return disagreement(by_vjp, by_dual);
}
/// The same of the avatar of all effects, restricted to these.
template <EffectSet E>
double law_error(std::uint64_t seed) {
    return law_error<E>(restricted<E>(avatar_of_optics(seed)), restricted<E>(drivers_of_optics()),
                        seed);
}

/// Disagreement of <vjp, direction> with a central difference, for one random direction of all
/// parameters and of the head pose.
template <EffectSet E>
double difference_error(const TwoStream<double, E>& avatar, const Drivers<double, E>& drivers,
                        std::uint64_t seed) {
    const AvatarConfig config = tiny_config();
    TwoStreamTrace<double, E> trace;
    drive(ScalarBackend<>{}, avatar, {config, tiny_roles(), drivers}, trace);
    const Gaussians<double> w = random_like(trace.gaussians, Random{seed, 1});
    Gaussians<double> g = w;
    TwoStream<double, E> grad = zeros_like(avatar);
    const Vec<double, 6> g_pose =
        drive_vjp(ScalarBackend<>{}, avatar, {config, tiny_roles(), drivers}, trace, {g, grad});
    const TwoStream<double, E> direction = random_like(avatar, Random{seed, 3});
    const Columns<double> pose_direction = random_columns<double>(6, 1, Random{seed, 4});
    const auto moved = [&](double h) {
        TwoStream<double, E> a = avatar;
        TwoStream<double, E>::fields(
            [&](const std::string&, auto& x, const auto& d) { x += h * d; }, a, direction);
        Drivers<double, E> at = drivers;
        if constexpr (has_effect<E, ReadsHeadPose>) at.pose += h * pose_direction;
        TwoStreamTrace<double, E> t;
        drive(ScalarBackend<>{}, a, {config, tiny_roles(), at}, t);
        DotSum sum;
        sum.add_all(t.gaussians, w);
        return sum.sum;
    };
    DotSum by_vjp;
    by_vjp.add_all(grad, direction);
    if constexpr (has_effect<E, ReadsHeadPose>) by_vjp.add(g_pose, pose_direction);
    const double h = 1e-6;
    return std::abs(by_vjp.sum - (moved(h) - moved(-h)) / (2 * h)) / by_vjp.magnitude;
}

} // namespace rye::test
