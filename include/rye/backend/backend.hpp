// SPDX-License-Identifier: Apache-2.0
/// rye/backend/backend.hpp: where and how the inner loops run. A backend is a type in the signature
/// of every function whose code depends on it, never a macro inside a body.
#pragma once

#include <rye/core/concepts.hpp>
#include <rye/core/parallel.hpp>

namespace rye {

/// A backend names its threads. Inner loops that it has a tuned version of are chosen by overload
/// on the backend type; everything else runs the plain template.
template <class B>
concept Backend = Threads<typename B::threads>;

/// A backend with vectors of T: for these the tuned loops run.
template <class B, class T>
concept LaneBackend = Backend<B> && Real<T> && requires { typename B::template batch<T>; };

} // namespace rye
