// SPDX-License-Identifier: Apache-2.0
// The laws of splatting for the instruction set of this machine, and for narrower ones that it has
// too: a processor with AVX-512 runs vectors of 4, 8 and 16 floats.
#include <tuple>

#include <rye/backend/xsimd.hpp>

#include "splat.hpp"

namespace rye::test {

using Native = XsimdBackend<DefaultArch, Serial>;
#if defined(__AVX512F__) && defined(__AVX2__) && defined(__FMA__)
using Backends = std::tuple<Native, XsimdBackend<xsimd::fma3<xsimd::avx2>, Serial>,
                            XsimdBackend<xsimd::sse2, Serial>>;
#elif defined(__AVX__)
using Backends = std::tuple<Native, XsimdBackend<xsimd::sse2, Serial>>;
#else
using Backends = std::tuple<Native>;
#endif
TEST_CASE_TEMPLATE_APPLY(width_images, Backends);
TEST_CASE_TEMPLATE_APPLY(width_hard_scenes, Backends);
TEST_CASE_TEMPLATE_APPLY(width_presets, Backends);
TEST_CASE_TEMPLATE_APPLY(width_outputs, Backends);
TEST_CASE_TEMPLATE_APPLY(width_gradients, Backends);
TEST_CASE_TEMPLATE_APPLY(width_duals, Backends);

} // namespace rye::test
