// SPDX-License-Identifier: Apache-2.0
// A device has no kernels for what a camera sees through the cornea.
// expect: RefractsNothing
#include <rye/avatar/cuda/two_stream.hpp>
#include <rye/backend/cuda/emulation.hpp>

#if REJECT
using E = rye::More<rye::PaperEffects, rye::CornealRefraction>;
#else
using E = rye::PaperEffects;
#endif

using Avatar = rye::DeviceTwoStream<E, rye::EmulatedDevice>;
std::size_t held(const Avatar& avatar) { return avatar.bytes(); }
