// SPDX-License-Identifier: Apache-2.0
/// rye/rig/gaze_mechanism.hpp: dependence of an eyeball's Gaussians on its gaze, as a policy: the
/// rotation of the eyeball about its centre, and changes of its features. The default applies the
/// smallest rotation and keeps the features. Frames: the gaze is the optical axis in the head
/// frame; at rest it is +z.
#pragma once

#include <concepts>
#include <cstddef>

#include <rye/autodiff/dual.hpp>
#include <rye/core/fields.hpp>
#include <rye/core/random.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

namespace rye {

namespace detail {

/// Parameters of a policy that has none: an empty base.
template <class T, class Owner>
struct NoParameters {
    template <class F, class... P>
    static void fields(F&&, P&&...) {}
};

} // namespace detail

/// Smallest rotation from +z to the gaze, without torsion (paper 3.2). A base for other mechanisms,
/// which override parts of it. Arguments of all functions but init begin with the parameters, the
/// eye (0: the subject's left) and that eye's gaze, a unit vector.
struct ExplicitRotation {
    /// True if features() changes anything.
    static constexpr bool changes_features = false;

    template <class T>
    using Parameters = detail::NoParameters<T, ExplicitRotation>;
    /// Returns the initial parameters of an avatar with `channels` features per Gaussian.
    template <class P>
    static P init(int, const Random&) {
        return {};
    }
    /// Returns the eyeball's rotation, a unit quaternion. Arguments: parameters, eye, gaze.
    template <class P, class T>
    static Quat<T> turn(const P&, std::size_t, const Vec3<T>& gaze) {
        return shortest_arc(Vec3<T>(T(0), T(0), T(1)), gaze);
    }
    /// Adds to the parameters' gradient; returns the gaze's cotangent. `g_turn` is that of the four
    /// numbers (w, x, y, z) of turn's result. Arguments: parameters, eye, gaze, g_turn, gradient.
    /// A dual with a number for each input, as here, spares deriving.
    template <class P, class T>
    static Vec3<T> turn_vjp(const P&, std::size_t, const Vec3<T>& gaze, const Quat<T>& g_turn, P&) {
        using D = Dual<T, 3>;
        Vec3<D> x;
        for (int k = 0; k < 3; ++k) x[k] = D::variable(gaze[k], k);
        const Quat<D> q = shortest_arc(Vec3<D>(D(0), D(0), D(1)), x);
        Vec3<T> g(T(0), T(0), T(0));
        for (int k = 0; k < 3; ++k)
            for (int i = 0; i < 4; ++i) g[k] += g_turn[i] * q[i].d[static_cast<std::size_t>(k)];
        return g;
    }
    /// Changes the features of one eyeball's P Gaussians, C x P, in place. Arguments: parameters,
    /// eye, gaze, features.
    template <class P, class T>
    static void features(const P&, std::size_t, const Vec3<T>&, ColumnsSpan<T>) {}
    /// Replaces `g`, the cotangent of the changed features, C x P, by that of the features
    /// `before` the change; adds to the parameters' gradient; returns the gaze's cotangent.
    /// Arguments: parameters, eye, gaze, before, g, gradient.
    template <class P, class T>
    static Vec3<T> features_vjp(const P&, std::size_t, const Vec3<T>&, const ColumnsView<T>&,
                                ColumnsSpan<T>, P&) {
        return Vec3<T>(T(0), T(0), T(0));
    }
};

/// ExplicitRotation documents each function. Parameters<T> is a struct with fields().
template <class M>
concept GazeMechanism =
    requires(const typename M::template Parameters<float>& p,
             typename M::template Parameters<float>& grad, const Vec3<float>& gaze,
             const Quat<float>& g_turn, ColumnsSpan<float> features,
             const ColumnsView<float>& before, const Random& random) {
        { M::changes_features } -> std::convertible_to<bool>;
        {
            M::template init<typename M::template Parameters<float>>(3, random)
        } -> std::same_as<typename M::template Parameters<float>>;
        { M::turn(p, std::size_t(0), gaze) } -> std::same_as<Quat<float>>;
        { M::turn_vjp(p, std::size_t(0), gaze, g_turn, grad) } -> std::same_as<Vec3<float>>;
        M::features(p, std::size_t(0), gaze, features);
        {
            M::features_vjp(p, std::size_t(0), gaze, before, features, grad)
        } -> std::same_as<Vec3<float>>;
    };
static_assert(GazeMechanism<ExplicitRotation>);

namespace detail {

/// Returns the cotangent of a unit quaternion, given those of its matrix and of itself.
template <class T>
RYE_HD Quat<T> turn_cotangent_of(const Quat<T>& turn, const Mat3<T>& g_matrix,
                                 const Quat<T>& g_quaternion) {
    using D = Dual<T, 4>;
    Quat<D> q;
    for (int k = 0; k < 4; ++k) q[k] = D::variable(turn[k], k);
    const Mat3<D> r = quat_matrix(q);
    Quat<T> g = g_quaternion;
    for (int k = 0; k < 4; ++k)
        for (int i = 0; i < 9; ++i)
            g[k] += g_matrix(i / 3, i % 3) * r(i / 3, i % 3).d[static_cast<std::size_t>(k)];
    return g;
}

} // namespace detail

} // namespace rye
