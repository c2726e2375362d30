// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/own_effects.hpp: effects that a user writes: what they change of the driven face, in
/// the head frame, after rye's own effects and before the head's motion. docs/effects.md has one.
#pragma once

#include <string>
#include <vector>

#include <rye/avatar/drivers.hpp>
#include <rye/backend/scalar.hpp>
#include <rye/core/fields.hpp>
#include <rye/gaussian/view.hpp>

namespace rye {

/// An effect with its own parameters, Parameters<T>, which have fields(), and
///     add(backend, parameters, drivers, gaussians)                          changes the Gaussians
///     vjp(backend, parameters, drivers, before, g_gaussians, g_parameters)  before: add's input
/// Gaussians and their cotangents are a GaussianSpan<T>, `before` is a Gaussians<T>.
template <class X>
concept OwnEffect = Effect<X> &&
    requires(const typename X::template Parameters<float>& p,
             typename X::template Parameters<float>& grad, const ScalarBackend<>& backend,
             const Drivers<float, Effects<X>>& drivers, GaussianSpan<float>& g,
             const Gaussians<float>& before) {
    X::add(backend, p, drivers, g);
    X::vjp(backend, p, drivers, before, g, grad);
};

namespace detail {

template <class X, class T>
struct NoOwnParameters {};
template <class X, class T, bool own>
struct OwnParametersOf {
    using type = NoOwnParameters<X, T>;
};
template <class X, class T>
struct OwnParametersOf<X, T, true> {
    using type = typename X::template Parameters<T>;
};

} // namespace detail

/// The parameters of all own effects among these; empty if there is none.
template <class T, EffectSet E>
struct OwnParameters;
template <class T, class... X>
struct OwnParameters<T, Effects<X...>>
    : detail::OwnParametersOf<X, T, OwnEffect<X>>::type... {
    /// Calls f(effect, parameters...) for each, in the order of the list.
    template <class F, class... P>
    static void each(F&& f, P&&... p) {
        const auto one = [&]<class Y>(Y effect) {
            using Parameters = typename detail::OwnParametersOf<Y, T, OwnEffect<Y>>::type;
            if constexpr (OwnEffect<Y>) f(effect, as<Parameters>(p)...);
        };
        (one(X{}), ...);
    }
    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        each(
            [&]<class Y>(Y, auto&&... q) {
                detail::nested_fields<typename Y::template Parameters<T>>(std::string(Y::name), f,
                                                                          q...);
            },
            p...);
    }

  private:
    template <class Parameters, class P>
    static auto& as(P& p) {
        return static_cast<std::conditional_t<std::is_const_v<P>, const Parameters, Parameters>&>(
            p);
    }
};

/// True if there are any.
template <EffectSet E>
inline constexpr bool has_own_effects = false;
template <class... X>
inline constexpr bool has_own_effects<Effects<X...>> = (OwnEffect<X> || ...);

namespace detail {

struct OwnEffectsLeftOut {};

} // namespace detail

/// The face before each own effect, which their vjps read; nothing where there is none.
template <class T, EffectSet E>
using OwnTrace = std::conditional_t<has_own_effects<E>, std::vector<Gaussians<T>>,
                                    Without<detail::OwnEffectsLeftOut>>;

namespace detail {

/// Changes the face in the head frame.
template <class T, EffectSet E, Backend B>
void add_own_effects(const B& backend, const OwnParameters<T, E>& own, const Drivers<T, E>& drivers,
                     GaussianSpan<T> face, OwnTrace<T, E>& before) {
    std::size_t k = 0;
    OwnParameters<T, E>::each([&]<class Y>(Y, const auto& p) {
        if (before.size() == k) before.emplace_back();
        Gaussians<T>& kept = before[k++];
        kept.mean = face.mean;
        kept.rotation = face.rotation;
        kept.scale = face.scale;
        kept.opacity = face.opacity;
        kept.feature = face.feature;
        Y::add(backend, p, drivers, face);
    }, own);
}

/// A frame's own effects, as far as their vjps read them.
template <class T, EffectSet E>
struct OwnPass {
    const Drivers<T, E>& drivers;
    const OwnTrace<T, E>& before;
};

/// Turns the cotangent of the changed face into that of the face before its own effects.
template <class T, EffectSet E, Backend B>
void own_effects_vjp(const B& backend, const OwnParameters<T, E>& own,
                     const std::type_identity_t<OwnPass<T, E>>& pass, GaussianSpan<T> g_face,
                     OwnParameters<T, E>& grad) {
    const OwnTrace<T, E>& before = pass.before;
    for (std::size_t last = before.size(); last-- > 0;) {
        std::size_t k = 0;
        OwnParameters<T, E>::each(
            [&]<class Y>(Y, const auto& p, auto& g) {
                if (k++ == last) Y::vjp(backend, p, pass.drivers, before[last], g_face, g);
            },
            own, grad);
    }
}

} // namespace detail

} // namespace rye
