// SPDX-License-Identifier: Apache-2.0
/// training/dispatch.hpp: from what a scene calls for to what was compiled. Variants are types
/// that state their effects; a list of them is bounded, and given by the caller, so that a program
/// compiles what it wants and no more. The smallest one that contains the effects is run.
#pragma once

#include <array>
#include <concepts>
#include <string>

#include <rye/core/error.hpp>
#include <rye/rig/effect_names.hpp>

namespace rye::trainer {

/// A type with `static constexpr EffectMask effects`, and a value without arguments.
template <class V>
concept Variant = std::default_initializable<V> && requires {
    { V::effects } -> std::convertible_to<EffectMask>;
    typename std::integral_constant<std::uint32_t, V::effects.bits>;  // known while compiling
};

/// Each variant is compiled whole: more than these are a mistake.
inline constexpr std::size_t most_variants = 16;

/// Variants that a program is compiled for.
template <Variant... V>
struct Variants {
    static constexpr std::size_t count = sizeof...(V);
    static_assert(count >= 1 && count <= most_variants, "Variants: expected 1 to 16 of them");
    static constexpr std::array<EffectMask, count> effects{V::effects...};

    /// Of those that contain the effects the one with the fewest, the first if several have as
    /// few; count, if none does.
    static constexpr std::size_t smallest(const EffectMask& called) {
        std::size_t best = count;
        for (std::size_t k = 0; k < count; ++k)
            if (effects[k].contains(called) &&
                (best == count || effects[k].count() < effects[best].count()))
                best = k;
        return best;
    }
};

namespace detail {

/// Effects that no variant has together, for the error.
template <class List>
std::string nearest_variant(const EffectMask& called) {
    EffectMask missing = called;
    for (const EffectMask& e : List::effects)
        if (called.without(e).count() < missing.count()) missing = called.without(e);
    return text_of(missing);
}

} // namespace detail

/// f(variant) of the smallest variant that contains the effects; Error if there is none.
template <Variant First, Variant... Rest, class F>
decltype(auto) dispatch(Variants<First, Rest...>, const EffectMask& called, F&& f) {
    using List = Variants<First, Rest...>;
    const std::size_t k = List::smallest(called);
    if (k == List::count)
        throw Error("dispatch: got a scene that calls for " + text_of(called) +
                    ", expected one of " + std::to_string(List::count) +
                    " compiled variants to have all of it; the nearest lacks " +
                    detail::nearest_variant<List>(called));
    const auto run = [&]<class V, class... More>(const auto& self, std::size_t left, V,
                                                 More... more) -> decltype(f(First{})) {
        if constexpr (sizeof...(More) > 0)
            if (left > 0) return self(self, left - 1, more...);
        return f(V{});
    };
    return run(run, k, First{}, Rest{}...);
}

} // namespace rye::trainer
