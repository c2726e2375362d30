// SPDX-License-Identifier: Apache-2.0
#include "data/threads.hpp"

#include <iostream>
#include <memory>

namespace rye::trainer {
namespace {

std::unique_ptr<ThreadPool>& pool() {
    static std::unique_ptr<ThreadPool> one;
    return one;
}

} // namespace

void set_threads(int threads) {
    pool().reset();  // its threads count towards the system's limit
    pool() = std::make_unique<ThreadPool>(threads);
    if (pool()->size() < pool()->asked())
        std::cerr << "rye: warning: the system started " << pool()->size() << " of "
                  << pool()->asked() << " threads; going on with these\n";
}

ProgramThreads program_threads() {
    if (!pool()) set_threads(0);
    return pool()->threads();
}

} // namespace rye::trainer
