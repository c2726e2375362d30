// SPDX-License-Identifier: Apache-2.0
// The laws of splatting for 4 lanes of floats and 2 of doubles, on any machine.
#include "../support/array_lanes.hpp"
#include "splat.hpp"

namespace rye::test {

using Lanes4 = ArrayBackend<4>;
TEST_CASE_TEMPLATE_INVOKE(width_images, Lanes4);
TEST_CASE_TEMPLATE_INVOKE(width_hard_scenes, Lanes4);
TEST_CASE_TEMPLATE_INVOKE(width_presets, Lanes4);
TEST_CASE_TEMPLATE_INVOKE(width_outputs, Lanes4);
TEST_CASE_TEMPLATE_INVOKE(width_gradients, Lanes4);
TEST_CASE_TEMPLATE_INVOKE(width_duals, Lanes4);

} // namespace rye::test
