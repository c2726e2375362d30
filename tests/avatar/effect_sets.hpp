// SPDX-License-Identifier: Apache-2.0
/// tests/avatar/effect_sets.hpp: a tiny avatar that has every effect, and what it is driven by.
#pragma once

#include <rye/avatar/hold.hpp>
#include <rye/avatar/neutral.hpp>

#include "../train/tiny_avatar.hpp"

namespace rye::test {

using AllEffects = More<PaperEffects, Kappa>;

/// An avatar of every effect, none of them neutral.
inline TwoStream<double, AllEffects> avatar_of_all(std::uint64_t seed = 7) {
    Draw draw{{seed, 1}};
    TwoStream<double, AllEffects> a = restricted<AllEffects>(tiny_avatar(tiny_config(), draw));
    a.eyes.kappa = draw.columns(2, 2, 0.1);
    return a;
}

inline Drivers<double, AllEffects> drivers_of_all() {
    return restricted<AllEffects>(tiny_drivers<double>());
}

template <class T, EffectSet E>
TwoStreamTrace<T, E> driven(const TwoStream<T, E>& avatar, const Drivers<T, E>& drivers) {
    TwoStreamTrace<T, E> trace;
    drive<ScalarBackend<>>(avatar, tiny_config(), tiny_roles(), drivers, trace);
    return trace;
}

} // namespace rye::test
