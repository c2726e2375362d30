// SPDX-License-Identifier: Apache-2.0
/// tests/support/flush_to_zero.hpp: the option --flush-to-zero of the test programs. A host program
/// or a library built with -ffast-math may set this processor mode for the whole process.
#pragma once

#include <cstring>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace rye {

/// Given the option, sets denormal results and operands to 0, in this thread and in those that it
/// shares work with.
inline void flush_to_zero_if_asked(int argc, char** argv) {
    for (int i = 1; i < argc; ++i) {
        if (std::strcmp(argv[i], "--flush-to-zero") != 0) continue;
#if defined(__x86_64__)
#if defined(_OPENMP)
#pragma omp parallel
#endif
        _mm_setcsr(_mm_getcsr() | 0x8040U);
#endif
    }
}

/// Whether this thread flushes denormals to zero.
inline bool flushed() {
    volatile float least = 1e-38F, half = 0.25F;
    return least * half == 0.0F;
}

} // namespace rye
