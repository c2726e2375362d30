// SPDX-License-Identifier: Apache-2.0
// None of the paper's effects looks from where the camera is.
// expect: Without<.*(Reads|8)
#include <rye/avatar/drivers.hpp>

#if REJECT
using Mine = rye::PaperEffects;
#else
using Mine = rye::More<rye::PaperEffects, rye::Glint>;
#endif

void seen_from(rye::Drivers<float, Mine>& drivers, const rye::Vec3<float>& camera) {
    drivers.camera = camera;
}
