// SPDX-License-Identifier: Apache-2.0
// An accuracy policy whose outputs are known when it runs, not when it is compiled.
// expect: A::outputs
#include <rye/splat/rasterizer.hpp>

struct Own : rye::Balanced {
#if REJECT
    static inline rye::Outputs outputs{};
#else
    static constexpr rye::Outputs outputs = {.depth = true};
#endif
};

auto draw(const rye::Gaussians<float>& g, const rye::Pinhole<float>& camera,
          const rye::VecX<float>& background) {
    return rye::Rasterizer<Own>{}.forward(rye::ScalarBackend<>{}, g, camera, background);
}
