// SPDX-License-Identifier: Apache-2.0
/// tests/support/backends.hpp: lists of backends, for each of which a law is instantiated by one
/// line (RYE_LAYER_LAWS, RYE_LANE_LAWS, RYE_SPLAT_LAWS).
#pragma once

#include <tuple>

#include <rye/backend/lanes.hpp>
#include <rye/backend/scalar.hpp>

#include "array_lanes.hpp"

namespace rye::test {

/// The backends of programs.
using ProgramBackends = std::tuple<ScalarBackend<>, XsimdBackend<>>;

/// Vectors of plain arrays of every width, on any machine.
using ArrayBackends = std::tuple<ArrayBackend<4>, ArrayBackend<8>, ArrayBackend<16>>;

/// The vectors of this machine, and narrower ones that it has too: a processor with AVX-512 runs
/// vectors of 4, 8 and 16 floats.
using Native = XsimdBackend<DefaultArch, Serial>;
#if defined(__AVX512F__) && defined(__AVX2__) && defined(__FMA__)
using ProcessorBackends = std::tuple<Native, XsimdBackend<xsimd::fma3<xsimd::avx2>, Serial>,
                                     XsimdBackend<xsimd::sse2, Serial>>;
#elif defined(__AVX__)
using ProcessorBackends = std::tuple<Native, XsimdBackend<xsimd::sse2, Serial>>;
#else
using ProcessorBackends = std::tuple<Native>;
#endif

} // namespace rye::test
