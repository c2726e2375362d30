// SPDX-License-Identifier: Apache-2.0
// The left eye of this avatar does not turn.
// expect: OnlyRightEye
#include <rye/avatar/two_stream.hpp>

#if REJECT
using Mine = rye::Less<rye::PaperEffects, rye::LeftGaze>;
#else
using Mine = rye::PaperEffects;
#endif

void look(rye::Drivers<float, Mine>& drivers, const rye::Vec3<float>& at) { drivers.gaze[0] = at; }
