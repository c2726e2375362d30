// SPDX-License-Identifier: Apache-2.0
// The paper's eyes are seen without refraction.
// expect: Without<.*rye::CornealRefraction
#include <rye/avatar/two_stream.hpp>

#if REJECT
using Mine = rye::PaperEffects;
#else
using Mine = rye::More<rye::PaperEffects, rye::CornealRefraction>;
#endif

void measured(rye::TwoStream<float, Mine>& avatar, const rye::Columns<float>& index) {
    avatar.eyes.optics.index = index;
}
