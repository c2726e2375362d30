// SPDX-License-Identifier: Apache-2.0
/// tests/support/driven_eyes.hpp: the tiny avatar with features of the eyes that the frame drives.
#pragma once

#include <rye/rig/driven_features.hpp>

#include "avatar_law.hpp"

namespace rye::test {

using Driven = EyesBy<DrivenFeatures>;

/// The tiny avatar with networks for its eyes that are not silent.
template <EffectSet E>
TwoStream<double, E> driven_eyes(std::uint64_t seed) {
    TwoStream<double, E> a = restricted<E>(avatar_of_all(seed));
    const AppearanceSizes sizes = appearance_sizes<E>(tiny_config(), a.eyes.position.cols());
    for (std::size_t eye = 0; eye < 2; ++eye)
        a.eyes.networks[eye] =
            Mlp<double>::init(DrivenFeatures::shape(sizes), Random{seed, 3 + eye});
    return a;
}

template <EffectSet E>
double driven_law(std::uint64_t seed) {
    return law_error<E>(driven_eyes<E>(seed), restricted<E>(drivers_of_all()), seed);
}

} // namespace rye::test
