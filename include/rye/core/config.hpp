// SPDX-License-Identifier: Apache-2.0
/// rye/core/config.hpp: the only macros, and the version.
#pragma once

#include <cstddef>

#define RYE_VERSION_MAJOR 0
#define RYE_VERSION_MINOR 2
#define RYE_VERSION_PATCH 0

#if defined(__FAST_MATH__) && !defined(RYE_ALLOW_FAST_MATH)
#error "rye: -ffast-math removes the NaN checks that rye relies on; define RYE_ALLOW_FAST_MATH to accept that"
#endif

/// Marks a formula as callable from host and device code.
#if defined(__CUDACC__)
#define RYE_HD __host__ __device__
#else
#define RYE_HD
#endif

/// Marks a part of a kernel: nvcc makes device code of it, any other compiler host code, which
/// runs the same text by the emulation of backend/cuda/emulation.hpp.
#if defined(__CUDACC__)
#define RYE_DEVICE __device__
#else
#define RYE_DEVICE
#endif

/// Checks a precondition. Define RYE_ASSERT before including rye to handle a failure otherwise.
#ifndef RYE_ASSERT
#ifdef NDEBUG
#define RYE_ASSERT(condition, message) static_cast<void>(0)
#else
#include <cassert>
#define RYE_ASSERT(condition, message) assert((condition) && (message))
#endif
#endif

namespace rye {

/// Signed, as in Eigen, so that differences of indices are safe.
using Index = std::ptrdiff_t;

} // namespace rye
