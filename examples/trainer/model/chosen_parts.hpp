// SPDX-License-Identifier: Apache-2.0
/// model/chosen_parts.hpp: parts of an avatar (rye/rig/parts.hpp) chosen at run time, one of a
/// list. An avatar with such parts is one type, compiled once for all choices; the alternative that
/// its parameters hold is the choice.
#pragma once

#include <tuple>
#include <variant>

#include <rye/rig/parts.hpp>

namespace rye::trainer {

/// Parameters of one of several parts, with the fields of the one that is held.
template <class... P>
struct OneOfParameters {
    std::variant<P...> held;

    template <class F, class... Many>
    static void fields(F&& f, Many&&... many) {
        visit(std::get<0>(std::tie(many...)), [&]<std::size_t k>() {
            std::variant_alternative_t<k, std::variant<P...>>::fields(f, std::get<k>(many.held)...);
        });
    }
    /// Calls f<k>() with the index in the list of the alternative that `p` holds; returns its
    /// result.
    template <class F>
    static auto visit(const OneOfParameters& p, F&& f) {
        return at(p.held.index(), f, std::make_index_sequence<sizeof...(P)>());
    }

  private:
    template <class F, std::size_t... k>
    static auto at(std::size_t index, F& f, std::index_sequence<k...>) {
        using R = decltype(f.template operator()<0>());
        if constexpr (std::is_void_v<R>) {
            ((k == index ? f.template operator()<k>() : void()), ...);
        } else {
            R result{};
            ((k == index ? void(result = f.template operator()<k>()) : void()), ...);
            return result;
        }
    }
};

/// One of several gaze mechanisms, by default the first; `held` selects it. None may change
/// features.
template <GazeMechanism... M>
struct OneMechanism : ExplicitRotation {
    static_assert(!(M::changes_features || ...));
    template <class T>
    struct Parameters : OneOfParameters<typename M::template Parameters<T>...> {};
    template <std::size_t k>
    using At = std::tuple_element_t<k, std::tuple<M...>>;

    template <class P, class T>
    static Quat<T> turn(const P& p, std::size_t eye, const Vec3<T>& gaze) {
        return P::visit(
            p, [&]<std::size_t k>() { return At<k>::turn(std::get<k>(p.held), eye, gaze); });
    }
    template <class P, class T>
    static Vec3<T> turn_vjp(const P& p, std::size_t eye, const Vec3<T>& gaze, const Quat<T>& g_turn,
                            P& grad) {
        return P::visit(p, [&]<std::size_t k>() {
            return At<k>::turn_vjp(std::get<k>(p.held), eye, gaze, g_turn, std::get<k>(grad.held));
        });
    }
};

/// One of several eye appearances, by default the first; `held` selects it.
template <EyeAppearance... A>
struct OneAppearance {
    static constexpr bool reads_inputs = true;
    template <class T>
    struct Parameters : OneOfParameters<typename A::template Parameters<T>...> {};
    template <std::size_t k>
    using At = std::tuple_element_t<k, std::tuple<A...>>;

    template <class P>
    static P init(int, Index, const Random&) {
        return {};
    }
    template <class B, class P, class T>
    static void features(const B& backend, const P& p, const EyeInputs<T>& in,
                         ColumnsSpan<T> feature) {
        P::visit(p, [&]<std::size_t k>() {
            At<k>::features(backend, std::get<k>(p.held), in, feature);
        });
    }
    template <class B, class P, class T>
    static void features_vjp(const B& backend, const P& p, const EyeInputs<T>& in,
                             const ColumnsView<T>& g, P& grad) {
        P::visit(p, [&]<std::size_t k>() {
            At<k>::features_vjp(backend, std::get<k>(p.held), in, g, std::get<k>(grad.held));
        });
    }
};

} // namespace rye::trainer
