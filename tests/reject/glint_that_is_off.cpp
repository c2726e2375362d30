// SPDX-License-Identifier: Apache-2.0
// Eyes that only refract have no lights.
// expect: Without<.*rye::Glint
#include <rye/avatar/two_stream.hpp>

#if REJECT
using Mine = rye::Effects<rye::CornealRefraction>;
#else
using Mine = rye::Effects<rye::CornealRefraction, rye::Glint>;
#endif

void lit(rye::TwoStream<float, Mine>& avatar, const rye::Columns<float>& lights) {
    avatar.eyes.optics.light_position = lights;
}
