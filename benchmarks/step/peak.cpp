// SPDX-License-Identifier: Apache-2.0
#include "peak.hpp"

#include "../roofline/machine.hpp"

namespace rye::bench {

double measured_peak() { return machine().flops; }

} // namespace rye::bench
