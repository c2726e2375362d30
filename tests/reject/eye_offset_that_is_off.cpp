// SPDX-License-Identifier: Apache-2.0
// An avatar without EyeOffset has no network of it.
// expect: Without<rye::EyeOffset
#include <rye/avatar/two_stream.hpp>

#if REJECT
using Mine = rye::Less<rye::PaperEffects, rye::EyeOffset>;
#else
using Mine = rye::PaperEffects;
#endif

int layers(const rye::TwoStream<float, Mine>& avatar) {
    return avatar.eyes.offset.mlp.shape.layers();
}
