// SPDX-License-Identifier: Apache-2.0
// An avatar of the paper's effects has no shadows of lids.
// expect: Without<.*rye::LidShadow
#include <rye/avatar/two_stream.hpp>

#if REJECT
using Mine = rye::PaperEffects;
#else
using Mine = rye::More<rye::PaperEffects, rye::LidShadow>;
#endif

void shade(rye::TwoStream<float, Mine>& avatar, const rye::Columns<float>& numbers) {
    avatar.eyes.lid_shadow = numbers;
}
