// SPDX-License-Identifier: Apache-2.0
/// rye/core/eigen.hpp: Eigen, whose warnings are not a user's: neither those of its own code, nor
/// those that g++ gives of vectors of 8 and 16 numbers where it inlines them into a user's.
/// It is Eigen/Core alone: a program that calls Eigen's v.cross(w) or m.inverse() includes
/// Eigen/Geometry or Eigen/LU itself, else it compiles and does not link.
#pragma once
#if defined(__GNUC__)
#pragma GCC system_header // what it includes is one, too
#endif

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wuninitialized"
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#pragma GCC diagnostic ignored "-Warray-bounds"
#pragma GCC diagnostic ignored "-Wstringop-overread"
#endif
#include <Eigen/Core>
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic pop
#endif
