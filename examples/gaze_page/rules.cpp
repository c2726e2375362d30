// SPDX-License-Identifier: Apache-2.0
/// rules.cpp: the numbers of the accuracy policies that WebGPU draws by, from the headers: one
/// formula for all presets that have the rules of Balanced.
#include <type_traits>

#include <emscripten/emscripten.h>

#include <rye/c/rye.h>
#include <rye/splat/accuracy.hpp>

using namespace rye;

namespace {

struct Numbers {
    float alpha_min, alpha_max, stop, margin;

    template <AccuracyPolicy A>
    explicit Numbers(const A& a)
        : alpha_min(static_cast<float>(a.alpha_min)),
          alpha_max(static_cast<float>(a.alpha_max)),
          stop(static_cast<float>(a.stop)),
          margin(static_cast<float>(a.frustum_margin)) {
        static_assert(A::stop_rule == Stop::inclusive && A::support == Support::ellipse &&
                      A::antialias == Antialias::dilate && A::order == BlendOrder::by_centre &&
                      !A::has_floor && A::depth_bits == 32);
    }
};

} // namespace

/// Returns alpha_min, alpha_max, stop and margin of a rye_accuracy.
extern "C" EMSCRIPTEN_KEEPALIVE const float* page_rules(int accuracy) {
    static Numbers numbers{Balanced{}};
    numbers = accuracy == RYE_ACCURACY_FAST    ? Numbers(Fast{})
              : accuracy == RYE_ACCURACY_TIGHT ? Numbers(Tight{})
                                               : Numbers(Balanced{});
    return &numbers.alpha_min;
}
