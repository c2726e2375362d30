// SPDX-License-Identifier: Apache-2.0
// A device has no kernels for an effect of one's own.
// expect: HasPartsOfDevice
#include <rye/avatar/cuda/two_stream.hpp>
#include <rye/backend/cuda/emulation.hpp>

#include "own_effect.hpp"

#if REJECT
using E = rye::More<rye::PaperEffects, Blush>;
#else
using E = rye::More<rye::PaperEffects, rye::CornealRefraction>;
#endif

using Avatar = rye::DeviceTwoStream<E, rye::EmulatedDevice>;
std::size_t held(const Avatar& avatar) { return avatar.bytes(); }
