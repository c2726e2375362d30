// SPDX-License-Identifier: Apache-2.0
// Without a head pose the avatar has the scale of its own frame.
// expect: Without<.*rye::HeadPose
#include <rye/avatar/two_stream.hpp>

#if REJECT
using Mine = rye::Less<rye::PaperEffects, rye::HeadPose>;
#else
using Mine = rye::PaperEffects;
#endif

void grow(rye::Drivers<float, Mine>& drivers) { drivers.scale = 2; }
