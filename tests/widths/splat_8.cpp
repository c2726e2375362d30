// SPDX-License-Identifier: Apache-2.0
// The laws of splatting for 8 lanes of floats and 4 of doubles, on any machine.
#include "../support/array_lanes.hpp"
#include "splat.hpp"

namespace rye::test {

using Lanes8 = ArrayBackend<8>;
TEST_CASE_TEMPLATE_INVOKE(width_images, Lanes8);
TEST_CASE_TEMPLATE_INVOKE(width_hard_scenes, Lanes8);
TEST_CASE_TEMPLATE_INVOKE(width_presets, Lanes8);
TEST_CASE_TEMPLATE_INVOKE(width_outputs, Lanes8);
TEST_CASE_TEMPLATE_INVOKE(width_gradients, Lanes8);
TEST_CASE_TEMPLATE_INVOKE(width_duals, Lanes8);

} // namespace rye::test
