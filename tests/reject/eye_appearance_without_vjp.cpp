// SPDX-License-Identifier: Apache-2.0
// Generated colours without a derivative could not be trained.
// expect: EyeAppearance
#include <rye/rig/parts.hpp>

struct Grey {
    static constexpr bool reads_inputs = false;
    template <class T>
    using Parameters = rye::detail::NoParameters<T, Grey>;
    template <class P>
    static P init(int, rye::Index, const rye::Random&) {
        return {};
    }
    template <class B, class P, class T>
    static void features(const B&, const P&, const rye::EyeInputs<T>&,
                         rye::ColumnsSpan<T> feature) {
        feature.setConstant(T(0.5));
    }
#if !REJECT
    template <class B, class P, class T>
    static void features_vjp(const B&, const P&, const rye::EyeInputs<T>&,
                             const rye::ColumnsView<T>&, P&) {}
#endif
};

using Mine = rye::More<rye::PaperEffects, rye::EyesBy<Grey>>;
