// SPDX-License-Identifier: Apache-2.0
#include "data/threads.hpp"

#include <memory>

namespace rye::trainer {
namespace {

std::unique_ptr<ThreadPool>& pool() {
    static std::unique_ptr<ThreadPool> one;
    return one;
}

} // namespace

void set_threads(int threads) { pool() = std::make_unique<ThreadPool>(threads); }

ProgramThreads program_threads() {
    if (!pool()) set_threads(0);
    return pool()->threads();
}

} // namespace rye::trainer
