// SPDX-License-Identifier: Apache-2.0
// A pupil is that of an eye that turns.
// expect: PupilHasAGaze
#include <rye/rig/effects.hpp>

#if REJECT
using Mine = rye::Effects<rye::HeadPose, rye::Pupil>;
#else
using Mine = rye::Effects<rye::HeadPose, rye::RightGaze, rye::Pupil>;
#endif

static_assert(Mine::has<rye::Pupil>);
