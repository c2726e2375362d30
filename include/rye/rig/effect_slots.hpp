// SPDX-License-Identifier: Apache-2.0
/// rye/rig/effect_slots.hpp: members that exist only if an effect is on. Declare them
///     [[no_unique_address]] Slot<S, Expression, Mlp<T>> exp_color;
/// If the effect is off they are empty and take no memory, and any use is a compile error that
/// names Without<Expression> on the user's line.
#pragma once

#include <array>
#include <cstddef>

#include <rye/core/absent.hpp>
#include <rye/rig/effects.hpp>

namespace rye {

namespace detail {

/// V if the effect (or one of AnyOf, or a ReaderOf) is on, else an empty type.
template <EffectSet S, class X, class V, int number = 0>
using Slot = PresentIf<has_effect<S, X>, X, V, number>;

/// A value for the subject's left eye alone. It has no operator[], which is for two eyes.
template <class V>
struct OnlyLeftEye {
    V left{};
    template <class U>
    void operator[](U&&) const = delete;
};
/// A value for the subject's right eye alone. It has no operator[], which is for two eyes.
template <class V>
struct OnlyRightEye {
    V right{};
    template <class U>
    void operator[](U&&) const = delete;
};

} // namespace detail

/// Returns the value for an eye, 0 or 1, from an EachEye.
template <std::size_t eye, class A>
constexpr auto& of_eye(A& all) {
    if constexpr (requires { all.left; })
        return all.left;
    else if constexpr (requires { all.right; })
        return all.right;
    else
        return all[eye];
}

namespace detail {

/// V for each eye that has it: an array of two, one value, or an empty type.
template <bool left, bool right, class X, class V, int number = 0>
using EachEye = std::conditional_t<
    left && right, std::array<V, 2>,
    std::conditional_t<left, OnlyLeftEye<V>,
                       std::conditional_t<right, OnlyRightEye<V>, Without<X, number>>>>;

/// V for each eye that rotates.
template <EffectSet S, class V, int number = 0>
using GazeSlot =
    EachEye<eye_turns<S, 0>, eye_turns<S, 1>, AnyOf<LeftGaze, RightGaze>, V, number>;

/// V for each eye whose surrounding skin follows its gaze.
template <EffectSet S, class V, int number = 0>
using SkinSlot = EachEye<skin_follows<S, 0>, skin_follows<S, 1>, Periocular, V, number>;

/// V for each eye whose skin follows its gaze if Kappa is on, which then gets a gradient from the
/// skin.
template <EffectSet S, class V, int number = 0>
using KappaSlot = EachEye<skin_follows<S, 0> && has_effect<S, Kappa>,
                          skin_follows<S, 1> && has_effect<S, Kappa>, Kappa, V, number>;

/// V for each eye whose pupil is driven.
template <EffectSet S, class V, int number = 0>
using PupilSlot = EachEye<pupil_moves<S, 0>, pupil_moves<S, 1>, Pupil, V, number>;

/// Returns V(x), or an empty slot if V is absent.
template <class V>
constexpr V initial_slot([[maybe_unused]] double x) {
    if constexpr (is_absent<V>)
        return V{};
    else
        return V(x);
}

} // namespace detail

/// Calls `f.operator()<eye>()` for eye 0 (the left) and eye 1.
template <class F>
constexpr void for_eyes(F&& f) {
    f.template operator()<0>();
    f.template operator()<1>();
}

namespace detail {

/// Assigns b = a; does nothing if either is absent.
template <class A, class B>
void copy_slot(const A& a, B& b) {
    if constexpr (!is_absent<A> && !is_absent<B>) b = a;
}

} // namespace detail

} // namespace rye
