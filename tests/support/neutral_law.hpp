// SPDX-License-Identifier: Apache-2.0
/// tests/support/neutral_law.hpp: the law of neutral effects, for one scalar per program unit.
#pragma once

#include <cmath>

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>

#include "effect_sets.hpp"

namespace rye::test {

/// The largest difference of two clouds in units in the last place.
template <class T>
double ulps(const Gaussians<T>& a, const Gaussians<T>& b) {
    double most = 0;
    Gaussians<T>::fields([&](const std::string&, const auto& x, const auto& y) {
        for (Index i = 0; i < x.size(); ++i) {
            if (x(i) == y(i)) continue;
            const T size = std::max(std::abs(x(i)), std::abs(y(i)));
            const T unit = std::nextafter(size, std::numeric_limits<T>::infinity()) - size;
            most = std::max(most, static_cast<double>(std::abs(x(i) - y(i)) / unit));
        }
    }, a, b);
    return most;
}

/// An avatar of the effects E with all of X neutral equals the one without X, within `most` ulps;
/// with X not neutral it differs.
template <class T, EffectSet E, Effect... X>
void check_neutral(double most) {
    using Rest = Less<E, X...>;
    TwoStream<T, E> avatar = lifted<T>(restricted<E>(avatar_of_optics()));
    if constexpr (has_effect<E, ViewColor>) set_tiny_view_colors(avatar);
    Drivers<T, E> drivers = restricted<E>(drivers_of_optics()).template cast<T>();
    const auto apart = [&] {
        const auto with = driven(avatar, drivers);
        const auto without = driven(restricted<Rest>(avatar), restricted<Rest>(drivers));
        return ulps(with.gaussians, without.gaussians);
    };
    CHECK(apart() > 1000);
    (make_neutral<X>(avatar, drivers), ...);
    std::string names;
    ((names += std::string(X::name) + " "), ...);
    CHECK_MESSAGE(apart() <= most, names);
}

/// Two gazes are all there are: what follows a gaze goes with them.
template <class T, Effect X, Effect Y>
void check_pair(double most) {
    constexpr bool both_gazes = std::same_as<X, LeftGaze> && std::same_as<Y, RightGaze>;
    if constexpr (std::same_as<X, Y>)
        check_neutral<T, AllEffects, X>(most);
    else if constexpr (both_gazes)
        check_neutral<T, Less<AllEffects, Periocular, Kappa>, X, Y>(most);
    else
        check_neutral<T, AllEffects, X, Y>(most);
}

/// X by itself and with each of Y.
template <class T, Effect X, Effect... Y>
void check_pairs_of(double most) {
    (check_pair<T, X, Y>(most), ...);
}

/// Each of the effects and each pair. The bulge is the asset's: it has a test of its own.
template <class T>
void check_all_pairs(double most) {
    check_pairs_of<T, Expression, Expression, HeadPose, PoseResidual, LeftGaze, RightGaze,
                   EyeOffset, Kappa, Periocular>(most);
    check_pairs_of<T, HeadPose, HeadPose, PoseResidual, LeftGaze, RightGaze, EyeOffset, Kappa,
                   Periocular>(most);
    check_pairs_of<T, PoseResidual, PoseResidual, LeftGaze, RightGaze, EyeOffset, Kappa,
                   Periocular>(most);
    check_pairs_of<T, LeftGaze, LeftGaze, RightGaze, EyeOffset, Kappa, Periocular>(most);
    check_pairs_of<T, RightGaze, RightGaze, EyeOffset, Kappa, Periocular>(most);
    check_pairs_of<T, EyeOffset, EyeOffset, Kappa, Periocular>(most);
    check_pairs_of<T, Kappa, Kappa, Periocular>(most);
    check_pairs_of<T, Periocular, Periocular>(most);
}

/// X by itself, and with each of Y, among all effects, those of the cornea and shading.
template <class T, Effect X, Effect... Y>
void check_optics_pairs_of(double most) {
    check_neutral<T, OpticsEffects, X>(most);
    (check_neutral<T, OpticsEffects, X, Y>(most), ...);
}
template <class T>
void check_optics_pairs(double most) {
    check_optics_pairs_of<T, CornealRefraction, Glint, Expression, HeadPose, PoseResidual,
                          LeftGaze, RightGaze, EyeOffset, Kappa, Periocular>(most);
    check_optics_pairs_of<T, Glint, Expression, HeadPose, PoseResidual, LeftGaze, RightGaze,
                          EyeOffset, Kappa, Periocular>(most);
}
template <class T>
void check_shading_pairs(double most) {
    check_optics_pairs_of<T, HeadShading, Expression, HeadPose, PoseResidual, LeftGaze, RightGaze,
                          EyeOffset, Kappa, Periocular, CornealRefraction, Glint>(most);
}

} // namespace rye::test
