// SPDX-License-Identifier: Apache-2.0
/// examples/trainer/data/threads.hpp: the threads of the program: one pool, whose threads sleep
/// while they wait, so that other programs beside a training keep their share of the processors.
#pragma once

#include <rye/core/thread_pool.hpp>

namespace rye::trainer {

using ProgramThreads = ThreadPool::Handle;

/// All parallel code runs on these from now on; 0: as many as the machine has processors. Handles
/// from before the call become invalid.
void set_threads(int threads);

/// A pool of all processors, if set_threads was not called before.
ProgramThreads program_threads();

} // namespace rye::trainer
