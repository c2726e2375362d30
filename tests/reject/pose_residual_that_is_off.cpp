// SPDX-License-Identifier: Apache-2.0
// An avatar without PoseResidual has no network of it.
// expect: Without<rye::PoseResidual
#include <rye/avatar/two_stream.hpp>

#if REJECT
using Mine = rye::Less<rye::PaperEffects, rye::PoseResidual>;
#else
using Mine = rye::PaperEffects;
#endif

int layers(const rye::TwoStream<float, Mine>& avatar) {
    return avatar.face.pose_attributes.shape.layers();
}
