// SPDX-License-Identifier: Apache-2.0
// An avatar of the paper's effects has no pupils to drive.
// expect: Without<.*rye::Pupil
#include <rye/avatar/drivers.hpp>

#if REJECT
using Mine = rye::PaperEffects;
#else
using Mine = rye::More<rye::PaperEffects, rye::Pupil>;
#endif

void dilate(rye::Drivers<float, Mine>& drivers) { drivers.pupil[0] = 1.5f; }
