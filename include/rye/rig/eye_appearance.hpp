// SPDX-License-Identifier: Apache-2.0
/// rye/rig/eye_appearance.hpp: source of the features of the eyeballs' Gaussians, as a policy. The
/// default: free constants, one column per Gaussian. Another may generate them from the frame's
/// drivers (the paper's "dedicated dynamic generator", section 3.2).
#pragma once

#include <concepts>
#include <string>

#include <rye/core/columns.hpp>
#include <rye/core/fields.hpp>
#include <rye/core/random.hpp>

namespace rye {

/// Inputs of an eye appearance, of both eyes: the left one's columns first.
template <class T>
struct EyeInputs {
    const Columns<T>& position;   ///< template points about their centre, 3 x P
    Index left_points;            ///< number of the left eye's points
    const VecX<T>& expression;    ///< code of the frame; empty where no effect reads it
    const Columns<T>& gaze; ///< optical axes, head frame, 3 x 2; +z for an eye that does not rotate
};

/// The default appearance: a trained feature for each point.
struct FreeFeatures {
    /// Whether features() reads its inputs; if not, they are not prepared.
    static constexpr bool reads_inputs = false;

    /// Its trained parameters.
    template <class T>
    struct Parameters {
        Columns<T> feature;  ///< C x P: left eye, then right
        template <class F, class... P>
        static void fields(F&& f, P&&... p) {
            f("feature", p.feature...);
        }
    };
    /// Grey; small numbers that differ in channels beyond RGB.
    template <class P>
    static P init(int channels, Index points, const Random& random) {
        using T = typename decltype(P::feature)::Scalar;
        P p{Columns<T>::Constant(channels, points, T(0.5))};
        for (Index i = channels > 3 ? 3 : 0; i < channels; ++i)
            for (Index k = 0; k < points; ++k)
                p.feature(i, k) =
                    T(0.1 * (2 * random.uniform(static_cast<std::uint64_t>(k * channels + i)) - 1));
        return p;
    }
    /// Writes the features, C x P: whole columns, contiguous.
    template <class B, class P, class T>
    static void features(const B&, const P& p, const EyeInputs<T>&, ColumnsSpan<T> feature) {
        // As one array: a Ref of an unknown stride would be copied column by column.
        Eigen::Map<Columns<T>>(feature.data(), p.feature.rows(), p.feature.cols()) = p.feature;
    }
    /// Accumulates the parameters' gradient from the features' cotangent.
    template <class B, class P, class T>
    static void features_vjp(const B&, const P&, const EyeInputs<T>&, const ColumnsView<T>& g,
                             P& grad) {
        grad.feature += g;
    }
};

/// FreeFeatures documents each function. Parameters<T> is a struct with fields().
template <class A>
concept EyeAppearance =
    requires(const typename A::template Parameters<float>& p,
             typename A::template Parameters<float>& grad, const EyeInputs<float>& inputs,
             ColumnsSpan<float> feature, const ColumnsView<float>& g, const Random& random) {
        { A::reads_inputs } -> std::convertible_to<bool>;
        {
            A::template init<typename A::template Parameters<float>>(3, Index(1), random)
        } -> std::same_as<typename A::template Parameters<float>>;
        A::features(0, p, inputs, feature);
        A::features_vjp(0, p, inputs, g, grad);
    };
static_assert(EyeAppearance<FreeFeatures>);

} // namespace rye
