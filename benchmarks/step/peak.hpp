// SPDX-License-Identifier: Apache-2.0
/// benchmarks/step/peak.hpp: the machine's peak, measured in a unit that is compiled like the
/// roofline's; the step itself is compiled like the trainer.
#pragma once

namespace rye::bench {

/// Flops of one thread [1/s], a fused product counting as two.
double measured_peak();

} // namespace rye::bench
