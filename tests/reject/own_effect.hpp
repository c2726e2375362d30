// SPDX-License-Identifier: Apache-2.0
/// tests/reject/own_effect.hpp: an effect of one's own, for avatars that do not take any.
#pragma once

#include <rye/avatar/own_effects.hpp>

/// Adds red in proportion to the first expression coefficient.
struct Blush {
    static constexpr std::string_view name = "blush";
    static constexpr rye::Reads reads = rye::Reads::expression;
    static constexpr rye::Touches touches = rye::Touches::colour;
    static constexpr std::string_view neutral = "red 0";
    static constexpr rye::EffectBound droppable{1e-3, "the first expression coefficient"};

    template <class T>
    struct Parameters {
        rye::Columns<T> red; ///< 1 x N

        template <class F, class... P>
        static void fields(F&& f, P&&... p) {
            f("red", p.red...);
        }
    };
    template <class B, class T, class D>
    static void add(const B&, const Parameters<T>& p, const D& drivers, rye::GaussianSpan<T>& g) {
        g.feature.row(0) += drivers.expression[0] * p.red;
    }
    template <class B, class T, class D>
    static void vjp(const B&, const Parameters<T>&, const D& drivers, const rye::Gaussians<T>&,
                    rye::GaussianSpan<T>& g, Parameters<T>& grad) {
        grad.red += drivers.expression[0] * g.feature.row(0);
    }
};
