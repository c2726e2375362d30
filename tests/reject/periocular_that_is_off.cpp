// SPDX-License-Identifier: Apache-2.0
// The skin of this avatar does not follow its gaze.
// expect: Without<.*rye::Periocular
#include <rye/avatar/two_stream.hpp>

#if REJECT
using Mine = rye::Less<rye::PaperEffects, rye::Periocular>;
#else
using Mine = rye::PaperEffects;
#endif

int layers(const rye::TwoStream<float, Mine>& avatar) {
    return avatar.face.networks.gaze_deform[0].shape.layers();
}
