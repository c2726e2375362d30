// SPDX-License-Identifier: Apache-2.0
/// benchmarks/roofline/machine.hpp: what one thread of this machine does at most, measured in the
/// run that uses it.
#pragma once

#include <cstdio>

#include "memory.hpp"
#include "order.hpp"
#include "rates.hpp"

namespace rye::bench {

/// Peak rates of one thread.
struct Machine {
    double flops;            ///< float, a fused product counting as two [1/s]
    double cycles;           ///< of a core [1/s]
    double lanes;            ///< floats of a vector
    double keys;             ///< 32-bit keys sorted with 32-bit values, 100000 of them [1/s]
    double entries;          ///< numbers appended to 1024 lists [1/s]
    MemorySpeeds memory;

    /// Returns fused products of whole vectors [1/s].
    double vector_products() const { return flops / (2 * lanes); }
};

/// Measures the peak rate of products, once a process; says so on stderr if no processor does that.
inline const ProductRates& peak() {
    static const ProductRates rates = [] {
        auto r = ProductRates::measured<Floats>(100);
        const std::string wrong = r.unmeasured() + r.impossible();
        if (!wrong.empty()) std::fprintf(stderr, "the peak is not one: %s\n", wrong.c_str());
        return r;
    }();
    return rates;
}

/// Measures all of it, once a process.
inline const Machine& machine() {
    static const Machine m{peak().flops(), peak().cycles(),    peak().lanes(),
                           sorted_keys(),  appended_entries(), measured_speeds()};
    return m;
}

} // namespace rye::bench
