// SPDX-License-Identifier: Apache-2.0
// Nothing of this avatar reads an expression.
// expect: Reads::expression
#include <rye/avatar/two_stream.hpp>

#if REJECT
using Mine = rye::Effects<rye::HeadPose, rye::LeftGaze, rye::RightGaze>;
#else
using Mine = rye::PaperEffects;
#endif

void smile(rye::Drivers<float, Mine>& drivers, const rye::VecX<float>& coefficients) {
    drivers.expression = coefficients;
}
