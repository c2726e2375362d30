// SPDX-License-Identifier: Apache-2.0
// The body of a parallel loop is given the bounds of its chunk, not one index.
// expect: invocable
#include <rye/core/parallel.hpp>

void fill(double* x, rye::Index n) {
#if REJECT
    rye::for_chunks(rye::Serial{}, n, 64, [&](rye::Index i) { x[i] = 1.0; });
#else
    rye::for_chunks(rye::Serial{}, n, 64, [&](rye::Index begin, rye::Index end, rye::Index) {
        for (rye::Index i = begin; i < end; ++i) x[i] = 1.0;
    });
#endif
}
