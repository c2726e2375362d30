// SPDX-License-Identifier: Apache-2.0
/// rye/rig/eye_appearance.hpp: source of the features of the eyeballs' Gaussians, as a policy. The
/// default is free constants, one column per Gaussian. A policy may also generate them from the
/// frame's drivers (the paper's "dedicated dynamic generator", section 3.2):
/// rig/driven_features.hpp.
#pragma once

#include <array>
#include <concepts>
#include <string>
#include <type_traits>

#include <rye/core/columns.hpp>
#include <rye/core/fields.hpp>
#include <rye/core/random.hpp>
#include <rye/math/linalg.hpp>

namespace rye {

/// Inputs of an eye appearance for both eyes; the left one's columns come first.
template <class T>
struct EyeInputs {
    const Columns<T>& position;   ///< template points about their centre, 3 x P
    Index left_points;            ///< number of the left eye's points
    const VecX<T>& expression;    ///< code of the frame; empty if no effect reads it
    const Columns<T>& gaze; ///< optical axes, head frame, 3 x 2; +z for an eye that does not rotate
    /// The head's axis-angle [rad] and translation [world unit], 6; empty if no effect reads it.
    const VecX<T>& pose;
};

namespace detail {

/// Cotangents of the inputs that depend on trained parameters: the gaze (by kappa) and the head
/// pose (by its correction for a frame).
template <class T>
struct EyeInputsCotangent {
    std::array<Vec3<T>, 2> gaze{Vec3<T>::Zero(), Vec3<T>::Zero()}; ///< of EyeInputs::gaze
    Vec<T, 6> pose = Vec<T, 6>::Zero(); ///< of EyeInputs::pose; 0 if that is empty
};

} // namespace detail

/// Sizes of an eye appearance and of its inputs.
struct AppearanceSizes {
    int channels;   ///< C, features of a Gaussian
    Index points;   ///< P, of both eyes
    int expression; ///< size of EyeInputs::expression
    int pose;       ///< size of EyeInputs::pose: 6 or 0
};

/// Default appearance: a trained feature for each point.
struct FreeFeatures {
    /// True if features() reads its inputs; if false, they are not prepared.
    static constexpr bool reads_inputs = false;

    /// Trained parameters.
    template <class T>
    struct Parameters {
        Columns<T> feature;  ///< C x P: left eye, then right
        template <class F, class... P>
        static void fields(F&& f, P&&... p) {
            f("feature", p.feature...);
        }
    };
    /// Returns grey, with small random numbers in channels beyond RGB.
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
    /// Writes the features, C x P, whole columns and contiguous.
    template <class B, class P, class T>
    static void features(const B&, const P& p, const EyeInputs<T>&, ColumnsSpan<T> feature) {
        // As one array: a Ref of unknown stride would be copied column by column.
        Eigen::Map<Columns<T>>(feature.data(), p.feature.rows(), p.feature.cols()) = p.feature;
    }
    /// Accumulates the parameters' gradient from the features' cotangent.
    template <class B, class P, class T>
    static void features_vjp(const B&, const P&, const EyeInputs<T>&, const ColumnsView<T>& g,
                             P& grad) {
        grad.feature += g;
    }
};

/// FreeFeatures documents each function. Parameters<T> is a struct with fields(). An appearance
/// whose networks read the frame is initialised by init(AppearanceSizes, Random) instead, and its
/// features_vjp returns an EyeInputsCotangent<T> where features depend on gaze or head pose.
template <class A>
concept EyeAppearance =
    requires(const typename A::template Parameters<float>& p,
             typename A::template Parameters<float>& grad, const EyeInputs<float>& inputs,
             ColumnsSpan<float> feature, const ColumnsView<float>& g, const Random& random) {
        { A::reads_inputs } -> std::convertible_to<bool>;
        requires requires {
            {
                A::template init<typename A::template Parameters<float>>(3, Index(1), random)
            } -> std::same_as<typename A::template Parameters<float>>;
        } || requires(const AppearanceSizes& sizes) {
            {
                A::template init<typename A::template Parameters<float>>(sizes, random)
            } -> std::same_as<typename A::template Parameters<float>>;
        };
        A::features(0, p, inputs, feature);
        A::features_vjp(0, p, inputs, g, grad);
    };
static_assert(EyeAppearance<FreeFeatures>);

namespace detail {

/// Returns true if the frame drives the features of an eye (0: the left). An appearance that reads
/// its inputs may answer by driven(parameters, eye) if that depends on its parameters.
template <EyeAppearance A, class P>
bool drives_features([[maybe_unused]] const P& p, [[maybe_unused]] std::size_t eye) {
    if constexpr (requires { A::driven(p, eye); })
        return A::driven(p, eye);
    else
        return A::reads_inputs;
}

} // namespace detail

/// An appearance whose features of an eye depend on that eye's gaze alone, and are written by
/// eye_features(backend, parameters, inputs, eye, features of both).
template <class A>
concept EyeByEye = EyeAppearance<A> &&
                   requires(const typename A::template Parameters<float>& p,
                            const EyeInputs<float>& inputs, ColumnsSpan<float> feature) {
                       A::eye_features(0, p, inputs, std::size_t(0), feature);
                   };

/// Returns the initial parameters of an appearance.
template <EyeAppearance A, class T>
typename A::template Parameters<T> init_eye_appearance(const AppearanceSizes& sizes,
                                                       const Random& random) {
    using P = typename A::template Parameters<T>;
    if constexpr (requires { A::template init<P>(sizes, random); })
        return A::template init<P>(sizes, random);
    else
        return A::template init<P>(sizes.channels, sizes.points, random);
}

/// Calls features_vjp of any appearance; returns the cotangent of its inputs, 0 if it gives none.
template <EyeAppearance A, class B, class P, class T>
detail::EyeInputsCotangent<T> eye_appearance_vjp(const B& backend, const P& p,
                                                 const EyeInputs<T>& inputs,
                                                 const std::type_identity_t<ColumnsView<T>>& g,
                                                 P& grad) {
    if constexpr (std::is_void_v<decltype(A::features_vjp(backend, p, inputs, g, grad))>) {
        A::features_vjp(backend, p, inputs, g, grad);
        return {};
    } else {
        return A::features_vjp(backend, p, inputs, g, grad);
    }
}

} // namespace rye
