// SPDX-License-Identifier: Apache-2.0
// The laws of splatting for 16 lanes of floats and 8 of doubles, on any machine.
#include "../support/backends.hpp"
#include "../support/splat_laws.hpp"

namespace rye::test {

RYE_SPLAT_LAWS(std::tuple<ArrayBackend<16>>);

} // namespace rye::test
