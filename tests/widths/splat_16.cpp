// SPDX-License-Identifier: Apache-2.0
// The laws of splatting for 16 lanes of floats and 8 of doubles, on any machine.
#include "../support/array_lanes.hpp"
#include "splat.hpp"

namespace rye::test {

using Lanes16 = ArrayBackend<16>;
TEST_CASE_TEMPLATE_INVOKE(width_images, Lanes16);
TEST_CASE_TEMPLATE_INVOKE(width_hard_scenes, Lanes16);
TEST_CASE_TEMPLATE_INVOKE(width_presets, Lanes16);
TEST_CASE_TEMPLATE_INVOKE(width_outputs, Lanes16);
TEST_CASE_TEMPLATE_INVOKE(width_gradients, Lanes16);
TEST_CASE_TEMPLATE_INVOKE(width_duals, Lanes16);

} // namespace rye::test
