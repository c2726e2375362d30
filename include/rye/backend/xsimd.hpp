// SPDX-License-Identifier: Apache-2.0
/// rye/backend/xsimd.hpp: explicit lanes times threads. The only include of xsimd, whose system
/// headers leak macros; nothing else may include it but the kernels of this backend.
#pragma once

#include <xsimd/xsimd.hpp>

#include <rye/backend/backend.hpp>
#include <rye/core/concepts.hpp>

namespace rye {

/// The instruction set is a type, so units built for different ones do not collide.
template <class Arch = xsimd::default_arch, Threads P = DefaultThreads>
struct XsimdBackend {
    using threads = P;
    using arch = Arch;
    template <Real T>
    using batch = xsimd::batch<T, Arch>;
};
static_assert(Backend<XsimdBackend<>>);

template <class T, class A>
struct RealOf<xsimd::batch<T, A>> {
    using type = T;
};
template <class T, class A>
const xsimd::batch<T, A>& value_of(const xsimd::batch<T, A>& x) {
    return x;
}

} // namespace rye
