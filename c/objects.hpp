// SPDX-License-Identifier: Apache-2.0
/// c/objects.hpp: settings and threads of the objects of rye/c/rye.h.
#pragma once

#include <rye/backend/lanes.hpp>
#if !defined(__EMSCRIPTEN__) || defined(__EMSCRIPTEN_PTHREADS__)
#include <rye/core/thread_pool.hpp>
#endif

#include "status.hpp"

namespace rye::c {

/// The largest number of threads that is accepted.
inline constexpr int most_threads = 1024;

inline rye_options checked_options(const rye_options* options) {
    if (options == nullptr) return RYE_INIT(rye_options);
    check_struct(options, "options");
    require(options->threads >= 0 && options->threads <= most_threads, "options: threads", "got ",
            options->threads, ", expected 0 to ", most_threads);
    require(options->accuracy >= 0 && options->accuracy <= RYE_ACCURACY_3DGS, "options: accuracy",
            "got ", options->accuracy, ", expected 0 to 3");
    return *options;
}

/// The threads of an object. WebAssembly that was compiled without -pthread has one; where its
/// memory is not shared, or too few workers are at hand, a pool starts those that it can.
#if defined(__EMSCRIPTEN__) && !defined(__EMSCRIPTEN_PTHREADS__)
struct ObjectThreads {
    explicit ObjectThreads(int) {}
    Serial threads() { return {}; }
};
using LibraryBackend = XsimdBackend<DefaultArch, Serial>;
#else
using ObjectThreads = ThreadPool;
using LibraryBackend = XsimdBackend<DefaultArch, ThreadPool::Handle>;
#endif

} // namespace rye::c
