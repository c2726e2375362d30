// SPDX-License-Identifier: Apache-2.0
// An effect must say what it reads.
// expect: Effect
#include <rye/rig/effects.hpp>

struct Blush {
    static constexpr std::string_view name = "blush";
#if !REJECT
    static constexpr rye::Reads reads = rye::Reads::expression;
#endif
    static constexpr rye::Touches touches = rye::Touches::colour;
    static constexpr std::string_view neutral = "no colour";
    static constexpr rye::EffectBound droppable{1e-3, "an expression coefficient"};
};

using Mine = rye::Effects<rye::HeadPose, Blush>;
