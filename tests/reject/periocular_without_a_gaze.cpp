// SPDX-License-Identifier: Apache-2.0
// There is no gaze for the skin to follow.
// expect: PeriocularHasAGaze
#include <rye/rig/effects.hpp>

#if REJECT
using Mine = rye::Effects<rye::HeadPose, rye::Periocular>;
#else
using Mine = rye::Effects<rye::HeadPose, rye::LeftGaze, rye::Periocular>;
#endif

static_assert(Mine::has<rye::Periocular>);
