// SPDX-License-Identifier: Apache-2.0
// Contributors are drawn where the outputs ask for them.
// expect: Without<.*rye::ContributorImage
#include <rye/splat/rasterizer.hpp>

#if REJECT
using Policy = rye::Balanced;
#else
using Policy = rye::Drawing<rye::Balanced, rye::Outputs{.depth = true, .contributor = true}>;
#endif

unsigned picked(const rye::Rasterizer<Policy>::Drawn<float>& picture) {
    return picture.contributor.pixels(0, 0);
}
