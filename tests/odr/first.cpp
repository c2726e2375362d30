// SPDX-License-Identifier: Apache-2.0
// Every header in two units of one program, one of them without OpenMP: functions that are not
// inline collide at link time, and threads hidden in a body would make one unit run the other's.
#include <all_headers.hpp>

#include <cstdio>

namespace rye::second_unit {
int threads();
double sum(Index n);
} // namespace rye::second_unit

namespace {

template <rye::Backend B>
double sum(const B& backend, rye::Index n) {
    return rye::sum_chunks(backend.threads, n, 7, 0.0, [](rye::Index b, rye::Index e) {
        double s = 0;
        for (rye::Index i = b; i < e; ++i) s += 1.0 / static_cast<double>(i + 1);
        return s;
    });
}

} // namespace

int main() {
    const double here = sum(rye::ScalarBackend{}, 1000);
    const double there = rye::second_unit::sum(1000);
    const int threads = rye::DefaultThreads().size();
    const int threads_there = rye::second_unit::threads();
    std::printf("here %d threads, sum %.17g; there %d threads, sum %.17g\n", threads, here,
                threads_there, there);
    return here == there && threads_there == 1 && threads >= 1 ? 0 : 1;
}
