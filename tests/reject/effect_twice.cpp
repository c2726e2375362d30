// SPDX-License-Identifier: Apache-2.0
// An effect named twice would be simulated twice.
// expect: EachNamedOnce
#include <rye/rig/effects.hpp>

#if REJECT
using Mine = rye::Effects<rye::HeadPose, rye::HeadPose>;
#else
using Mine = rye::Effects<rye::HeadPose>;
#endif

static_assert(Mine::has<rye::HeadPose>);
