// SPDX-License-Identifier: Apache-2.0
/// drawing/dispatch.hpp: selection of a compiled variant by the effects that a scene needs.
/// Variants are types that state their effects; the caller gives a bounded list of them, so that a
/// program compiles only the ones it wants. The smallest variant that contains the effects is run.
#pragma once

#include <array>
#include <concepts>
#include <string>

#include <rye/core/error.hpp>
#include <rye/rig/effect_names.hpp>

namespace rye::trainer {

/// A default-constructible type with `static constexpr EffectMask effects`.
template <class V>
concept Variant = std::default_initializable<V> && requires {
    { V::effects } -> std::convertible_to<EffectMask>;
    typename std::integral_constant<std::uint32_t, V::effects.bits>;  // known at compile time
};

/// Largest number of variants. Each is compiled whole: more are a mistake.
inline constexpr std::size_t most_variants = 16;

/// Variants that a program is compiled for.
template <Variant... V>
struct Variants {
    static constexpr std::size_t count = sizeof...(V);
    static_assert(count >= 1 && count <= most_variants, "Variants: expected 1 to 16 of them");
    static constexpr std::array<EffectMask, count> effects{V::effects...};

    /// Returns the index of the variant with the fewest effects among those that contain `called`,
    /// the first of equals; `count` if there is none.
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

/// Returns the effects that no variant has together, for the error.
template <class List>
std::string nearest_variant(const EffectMask& called) {
    EffectMask missing = called;
    for (const EffectMask& e : List::effects)
        if (called.without(e).count() < missing.count()) missing = called.without(e);
    return text_of(missing);
}

} // namespace detail

/// Returns f(variant) for the smallest variant that contains the effects; throws an Error if there
/// is none.
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
