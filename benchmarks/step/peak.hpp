// SPDX-License-Identifier: Apache-2.0
/// benchmarks/step/peak.hpp: the machine's peak rates, measured in a unit compiled with the
/// roofline's flags; the step itself is compiled with the trainer's.
#pragma once

namespace rye::bench {

/// Flops of one thread [1/s], a fused product counting as two.
double measured_peak();

/// The rates of n threads at once, relative to one: fused products in registers; bytes of
/// a = b + s c.
struct Together {
    double products, bytes;
};
Together measured_together(int threads);

} // namespace rye::bench
