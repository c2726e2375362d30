// SPDX-License-Identifier: Apache-2.0
/// rye/backend/backend.hpp: concepts of a backend: a value that holds the resources the work runs
/// on, and the first argument of every function whose code depends on it. Its type selects the
/// inner loops by overload, never by a macro inside a body.
#pragma once

#include <concepts>
#include <type_traits>

#include <rye/core/concepts.hpp>
#include <rye/core/parallel.hpp>

namespace rye {

/// A type with a member `threads`. Overloads on the backend's type select tuned inner loops;
/// everything else runs the plain template. Functions with such overloads are called without a
/// namespace, and are not in detail: a call of detail::f finds none that is declared later.
template <class B>
concept Backend = std::copy_constructible<B> && requires(const B& b) {
    requires Threads<std::remove_cvref_t<decltype(b.threads)>>;
};

/// Returns the same backend on the calling thread alone, for tasks that are themselves run side by
/// side. A backend of one's own has an overload, or stays as it is: its threads then take nested
/// calls.
template <Backend B>
B one_thread(const B& backend) {
    return backend;
}

/// A backend with SIMD vectors of T, on which the tuned loops run.
template <class B, class T>
concept LaneBackend = Backend<B> && Real<T> && requires { typename B::template batch<T>; };

/// Backend of a call without one if no header of lanes, such as splat/lanes.hpp, is included. It
/// is no Backend, so the call does not compile: include the header, or give ScalarBackend{}.
struct NoDefaultBackend {};

/// The backend of calls without one, for scalars T: completed by backend/lanes.hpp, so that those
/// who give a ScalarBackend parse no xsimd. It is an argument of the template that is called, and
/// so in its name: units built with other instructions can be linked.
template <class T>
struct DefaultBackendOf {
    using type = NoDefaultBackend;
};
/// See DefaultBackendOf.
template <class T>
using DefaultBackend = typename DefaultBackendOf<T>::type;

} // namespace rye
