// SPDX-License-Identifier: Apache-2.0
/// rye/backend/scalar.hpp: the reference backend: plain loops over the templated formulas, for any
/// scalar, double and duals included.
///     ScalarBackend{}, ScalarBackend{Serial{}}, ScalarBackend{OpenMp{4}}
#pragma once

#include <rye/backend/backend.hpp>

namespace rye {

/// The plain loops on threads P.
template <Threads P = DefaultThreads>
struct ScalarBackend {
    [[no_unique_address]] P threads{};
};
template <Threads P>
ScalarBackend(P) -> ScalarBackend<P>;
static_assert(Backend<ScalarBackend<>>);

/// Returns the same backend on the calling thread alone.
template <Threads P>
ScalarBackend<Serial> one_thread(const ScalarBackend<P>&) {
    return {};
}

} // namespace rye
