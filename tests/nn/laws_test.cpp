// SPDX-License-Identifier: Apache-2.0
// The laws of layers by plain loops and by the lanes of this machine.
#include "../support/backends.hpp"
#include "../support/layer_laws.hpp"

namespace rye::test {

RYE_LAYER_LAWS(ProgramBackends);
RYE_LANE_LAWS(std::tuple<Native>);

} // namespace rye::test
