// SPDX-License-Identifier: Apache-2.0
// The unit without OpenMP, with the headers in the other order; see first.cpp.
#include <all_headers_backwards.hpp>

#ifdef _OPENMP
#error "this unit must be built without OpenMP"
#endif

namespace rye::second_unit {

int threads() { return DefaultThreads().size(); }

double sum(Index n) {
    return sum_chunks(ScalarBackend{}.threads, n, 7, 0.0, [](Index b, Index e) {
        double s = 0;
        for (Index i = b; i < e; ++i) s += 1.0 / static_cast<double>(i + 1);
        return s;
    });
}

} // namespace rye::second_unit
