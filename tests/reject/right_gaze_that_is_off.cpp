// SPDX-License-Identifier: Apache-2.0
// The right eye of this avatar does not turn.
// expect: OnlyLeftEye
#include <rye/avatar/two_stream.hpp>

#if REJECT
using Mine = rye::Less<rye::PaperEffects, rye::RightGaze>;
#else
using Mine = rye::PaperEffects;
#endif

void look(rye::Drivers<float, Mine>& drivers, const rye::Vec3<float>& at) { drivers.gaze[1] = at; }
