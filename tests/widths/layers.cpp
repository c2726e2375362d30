// SPDX-License-Identifier: Apache-2.0
// The laws of all lane code but splatting for 4, 8 and 16 floats and 2, 4 and 8 doubles, on any
// machine. One unit, so that Eigen's products, most of its compile time, are compiled once.
#include "../support/array_lanes.hpp"
#include "layers.hpp"

namespace rye::test {

using Lanes4 = ArrayBackend<4>;
using Lanes8 = ArrayBackend<8>;
using Lanes16 = ArrayBackend<16>;
TEST_CASE_TEMPLATE_INVOKE(width_lanes, Lanes4, Lanes8, Lanes16);
TEST_CASE_TEMPLATE_INVOKE(width_products, Lanes4, Lanes8, Lanes16);
TEST_CASE_TEMPLATE_INVOKE(width_convolutions, Lanes4, Lanes8, Lanes16);
TEST_CASE_TEMPLATE_INVOKE(width_networks, Lanes4, Lanes8, Lanes16);
TEST_CASE_TEMPLATE_INVOKE(width_upsamplers, Lanes4, Lanes8, Lanes16);
TEST_CASE_TEMPLATE_INVOKE(width_adam, Lanes4, Lanes8, Lanes16);
TEST_CASE_TEMPLATE_INVOKE(width_dssim, Lanes4, Lanes8, Lanes16);
TEST_CASE_TEMPLATE_INVOKE(width_nearest, Lanes4, Lanes8, Lanes16);
TEST_CASE_TEMPLATE_INVOKE(width_formulas, Lanes4, Lanes8, Lanes16);

} // namespace rye::test
