// SPDX-License-Identifier: Apache-2.0
// The paper's avatar has no kappa.
// expect: Without<.*rye::Kappa
#include <rye/avatar/two_stream.hpp>

#if REJECT
using Mine = rye::PaperEffects;
#else
using Mine = rye::More<rye::PaperEffects, rye::Kappa>;
#endif

void measured(rye::TwoStream<float, Mine>& avatar, const rye::Columns<float>& angles) {
    avatar.eyes.kappa = angles;
}
