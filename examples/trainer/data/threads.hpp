// SPDX-License-Identifier: Apache-2.0
/// examples/trainer/data/threads.hpp: the program's pool of threads, which sleep while they wait,
/// so that other programs keep their share of the processors.
#pragma once

#include <rye/core/thread_pool.hpp>

namespace rye::trainer {

using ProgramThreads = ThreadPool::Handle;

/// Sets the number of threads of all parallel code; 0: one per processor. Invalidates earlier
/// handles. Warns on standard error if the system starts fewer.
void set_threads(int threads);

/// Returns the pool; it has a thread per processor if set_threads was not called before.
ProgramThreads program_threads();

} // namespace rye::trainer
