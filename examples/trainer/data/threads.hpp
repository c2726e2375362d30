// SPDX-License-Identifier: Apache-2.0
/// examples/trainer/data/threads.hpp: the threads of the program: one pool, whose threads sleep
/// while they wait, so that other programs keep their share of the processors.
#pragma once

#include <rye/core/thread_pool.hpp>

namespace rye::trainer {

using ProgramThreads = ThreadPool::Handle;

/// Sets the number of threads of all parallel code; 0: one per processor. Invalidates earlier
/// handles. Warns on standard error where the system starts fewer.
void set_threads(int threads);

/// A pool of all processors, if set_threads was not called before.
ProgramThreads program_threads();

} // namespace rye::trainer
