// SPDX-License-Identifier: Apache-2.0
// The laws of splatting for the instruction set of this machine, and for the narrower ones that it
// has: a processor with AVX-512 runs vectors of 4, 8 and 16 floats.
#include <algorithm>
#include <cstdio>
#include <tuple>

#include <rye/backend/lanes.hpp>

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

TEST_CASE("widths: vectors as wide as the processor has them") {
    std::size_t widest = 0;
    const auto name = [&]<class B>(B) {
        using Arch = typename B::arch;
        constexpr std::size_t lanes = B::template batch<float>::size;
        std::printf("the processor's own vectors of %zu floats: %s\n", lanes, Arch::name());
        widest = std::max(widest, lanes);
    };
    std::apply([&](auto... backend) { (name(backend), ...); }, Backends());
#if defined(__AVX512F__)
    CHECK(widest == 16);
#else
    std::printf("not run: the processor's own vectors of 16 floats, for this build has no AVX-512; "
                "test_widths runs vectors of plain arrays\n");
#if defined(__AVX__)
    CHECK(widest == 8);
#else
    CHECK(widest == 4);
#endif
#endif
}

} // namespace rye::test
