// SPDX-License-Identifier: Apache-2.0
// An eyeball without a bulge is a sphere, and has no cornea.
// expect: Without<.*rye::CornealBulge
#include <rye/rig/eyeball.hpp>

#if REJECT
using Mine = rye::Less<rye::PaperEffects, rye::CornealBulge>;
#else
using Mine = rye::PaperEffects;
#endif

void flatten(rye::BasicEyeballShape<Mine>& shape) { shape.cornea_offset = 0.05; }
