// SPDX-License-Identifier: Apache-2.0
/// rye/rig/effect_slots.hpp: members that exist only where an effect is on. Declare them
///     [[no_unique_address]] Slot<S, Expression, Mlp<T>> exp_color;
/// Where the effect is off they are empty and take no memory, and any use is a compile error that
/// names Without<Expression>, on the user's line.
#pragma once

#include <array>
#include <cstddef>

#include <rye/core/absent.hpp>
#include <rye/rig/effects.hpp>

namespace rye {

/// V where the effect (or one of AnyOf, or a ReaderOf) is on.
template <EffectSet S, class X, class V, int number = 0>
using Slot = PresentIf<has_effect<S, X>, X, V, number>;

/// A value of the subject's left (or right) eye alone, without operator[], which is for two eyes.
template <class V>
struct OnlyLeftEye {
    V left{};
    template <class U>
    void operator[](U&&) const = delete;
};
/// A value of the subject's right eye alone, without operator[], which is for two eyes.
template <class V>
struct OnlyRightEye {
    V right{};
    template <class U>
    void operator[](U&&) const = delete;
};

/// The value of an eye, 0 or 1, of both or of the only one.
template <std::size_t eye, class A>
constexpr auto& of_eye(A& all) {
    if constexpr (requires { all.left; })
        return all.left;
    else if constexpr (requires { all.right; })
        return all.right;
    else
        return all[eye];
}

/// V per eye that has it: an array of two, one value, or empty.
template <bool left, bool right, class X, class V, int number = 0>
using EachEye = std::conditional_t<
    left && right, std::array<V, 2>,
    std::conditional_t<left, OnlyLeftEye<V>,
                       std::conditional_t<right, OnlyRightEye<V>, Without<X, number>>>>;

/// V per eye that rotates.
template <EffectSet S, class V, int number = 0>
using GazeSlot =
    EachEye<eye_turns<S, 0>, eye_turns<S, 1>, AnyOf<LeftGaze, RightGaze>, V, number>;

/// V per eye whose surrounding skin follows its gaze.
template <EffectSet S, class V, int number = 0>
using SkinSlot = EachEye<skin_follows<S, 0>, skin_follows<S, 1>, Periocular, V, number>;

/// V per eye whose skin follows its gaze, with Kappa, which then gets a gradient from the skin.
template <EffectSet S, class V, int number = 0>
using KappaSlot = EachEye<skin_follows<S, 0> && has_effect<S, Kappa>,
                          skin_follows<S, 1> && has_effect<S, Kappa>, Kappa, V, number>;

/// V(x), or an empty slot where V is absent.
template <class V>
constexpr V initial_slot([[maybe_unused]] double x) {
    if constexpr (is_absent<V>)
        return V{};
    else
        return V(x);
}

/// Calls `f.operator()<eye>()` for eye 0, the left, and 1.
template <class F>
constexpr void for_eyes(F&& f) {
    f.template operator()<0>();
    f.template operator()<1>();
}

/// Assigns b = a; does nothing where either is absent.
template <class A, class B>
void copy_slot(const A& a, B& b) {
    if constexpr (!is_absent<A> && !is_absent<B>) b = a;
}

} // namespace rye
