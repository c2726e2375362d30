// SPDX-License-Identifier: Apache-2.0
// The laws of all lane code but splatting for 4, 8 and 16 floats and 2, 4 and 8 doubles, on any
// machine. One unit, so that Eigen's products, most of its compile time, are compiled once.
#include "../support/backends.hpp"
#include "../support/layer_laws.hpp"

namespace rye::test {

RYE_LANE_LAWS(ArrayBackends);
RYE_LAYER_LAWS(ArrayBackends);

} // namespace rye::test
