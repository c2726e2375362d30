// SPDX-License-Identifier: Apache-2.0
// There is nothing for kappa to turn.
// expect: KappaHasAGaze
#include <rye/rig/effects.hpp>

#if REJECT
using Mine = rye::Effects<rye::HeadPose, rye::Kappa>;
#else
using Mine = rye::Effects<rye::HeadPose, rye::LeftGaze, rye::Kappa>;
#endif

static_assert(Mine::has<rye::Kappa>);
