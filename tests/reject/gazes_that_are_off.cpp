// SPDX-License-Identifier: Apache-2.0
// Neither eye of this avatar turns.
// expect: Without<.*rye::LeftGaze, rye::RightGaze
#include <rye/avatar/two_stream.hpp>

#if REJECT
using Mine = rye::Effects<rye::Expression, rye::HeadPose>;
#else
using Mine = rye::PaperEffects;
#endif

void look(rye::Drivers<float, Mine>& drivers, const rye::Vec3<float>& at) { drivers.gaze[0] = at; }
