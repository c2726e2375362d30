// SPDX-License-Identifier: Apache-2.0
/// rye/backend/scalar.hpp: the reference backend: plain loops over the templated formulas, for any
/// scalar, and so also for double and for duals.
#pragma once

#include <rye/backend/backend.hpp>

namespace rye {

template <Threads P = DefaultThreads>
struct ScalarBackend {
    using threads = P;
};
static_assert(Backend<ScalarBackend<>>);

} // namespace rye
