// SPDX-License-Identifier: Apache-2.0
/// rye/backend/backend.hpp: where and how the inner loops run. A backend is a value that holds what
/// the work runs on, and the first argument of every function whose code depends on it. Its type
/// selects the loops by overload, never by a macro inside a body.
#pragma once

#include <concepts>
#include <type_traits>

#include <rye/core/concepts.hpp>
#include <rye/core/parallel.hpp>

namespace rye {

/// A backend holds its threads. Inner loops that it has a tuned version of are chosen by overload
/// on the backend's type; everything else runs the plain template.
template <class B>
concept Backend = std::copy_constructible<B> && requires(const B& b) {
    requires Threads<std::remove_cvref_t<decltype(b.threads)>>;
};

/// A backend with vectors of T: for these the tuned loops run.
template <class B, class T>
concept LaneBackend = Backend<B> && Real<T> && requires { typename B::template batch<T>; };

} // namespace rye
