// SPDX-License-Identifier: Apache-2.0
// A user's own accuracy policy that has not all names of Balanced: the error names what is missing.
// expect: max_memory
#include <rye/splat/rasterizer.hpp>

struct Own {
    double alpha_min = 1e-3, alpha_max = 1, stop = 1e-4, dilation = 0.3, frustum_margin = 0.3,
           alpha_floor = 0;
    rye::NonFinite non_finite = rye::NonFinite::cull;
#if !REJECT
    std::uint64_t max_memory = 1 << 20;
#endif
    static constexpr rye::Stop stop_rule = rye::Stop::inclusive;
    static constexpr rye::Support support = rye::Support::ellipse;
    static constexpr rye::Antialias antialias = rye::Antialias::dilate;
    static constexpr rye::BlendOrder order = rye::BlendOrder::by_centre;
    static constexpr int depth_bits = 32;
    static constexpr bool has_floor = false;
    static constexpr rye::Outputs outputs = {};
    static constexpr rye::Payload payload = rye::Payload::whole;
    static constexpr int exp2_degree = 5;
};

rye::Raster<float> draw(const rye::Gaussians<float>& g, const rye::Pinhole<float>& camera,
                        const rye::VecX<float>& background) {
    return rye::Rasterizer<Own>{}.forward(rye::ScalarBackend<>{}, g, camera, background);
}
