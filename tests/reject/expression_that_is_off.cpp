// SPDX-License-Identifier: Apache-2.0
// An avatar without Expression has no network of it.
// expect: Without<rye::Expression
#include <rye/avatar/two_stream.hpp>

#if REJECT
using Mine = rye::Less<rye::PaperEffects, rye::Expression>;
#else
using Mine = rye::PaperEffects;
#endif

int layers(const rye::TwoStream<float, Mine>& avatar) {
    return avatar.face.networks.exp_color.shape.layers();
}
