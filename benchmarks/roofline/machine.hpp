// SPDX-License-Identifier: Apache-2.0
/// benchmarks/roofline/machine.hpp: what one thread of this machine does at most, measured in the
/// run that uses it.
#pragma once

#include "memory.hpp"
#include "order.hpp"
#include "products.hpp"

namespace rye::bench {

/// Peak rates of one thread.
struct Machine {
    double flops;            ///< float, a fused product counting as two [1/s]
    double cycles;           ///< of a core [1/s]
    double lanes;            ///< floats of a vector
    double keys;             ///< 32-bit keys sorted with 32-bit values, 100000 of them [1/s]
    double entries;          ///< numbers appended to 1024 lists [1/s]
    MemorySpeeds memory;

    /// Counts fused products of whole vectors [1/s].
    double vector_products() const { return flops / (2 * lanes); }
    /// Counts them a cycle.
    double products_a_cycle() const { return vector_products() / cycles; }
};

/// Measures the peak rate of products, once a process.
inline const PeakTurns& peak() {
    static const PeakTurns best = [] {
        PeakTurns t;
        for (int i = 0; i < 100; ++i) t.turn();
        return t;
    }();
    return best;
}

/// Measures all of it, once a process.
inline const Machine& machine() {
    static const Machine m{peak().flops,       peak().cycles,     double(ChainValues::lanes),
                           sorted_keys(),      appended_entries(), measured_speeds()};
    return m;
}

} // namespace rye::bench
