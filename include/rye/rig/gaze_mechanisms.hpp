// SPDX-License-Identifier: Apache-2.0
/// rye/rig/gaze_mechanisms.hpp: mechanisms to compare ExplicitRotation with: an eyeball that does
/// not rotate, whose appearance alone may follow the gaze (rig/gaze_features.hpp), and one whose
/// rotation is learned. They represent ideas of other methods inside rye's avatar, not those
/// methods. Frames: as in rig/gaze_mechanism.hpp.
/// Source of the learned rotation: Wei et al., "GazeGaussian", 2024, section 3.2.
#pragma once

#include <rye/backend/scalar.hpp>
#include <rye/nn/encoding.hpp>
#include <rye/nn/mlp.hpp>
#include <rye/rig/gaze_mechanism.hpp>

namespace rye {

/// Mechanism that keeps the eyeball's orientation at any gaze.
struct FixedEye : ExplicitRotation {
    template <class T>
    using Parameters = detail::NoParameters<T, FixedEye>;
    /// Returns the identity.
    template <class P, class T>
    static Quat<T> turn(const P&, std::size_t, const Vec3<T>&) {
        return quat_identity<T>();
    }
    /// Returns 0: nothing depends on the gaze.
    template <class P, class T>
    static Vec3<T> turn_vjp(const P&, std::size_t, const Vec3<T>&, const Quat<T>&, P&) {
        return Vec3<T>(T(0), T(0), T(0));
    }
};

/// Rotation by an MLP: the encoded pitch and yaw, and which eye it is, give a quaternion, which is
/// normalised. Before training it is the identity: the last layer starts at 0, and its output is
/// added to (1, 0, 0, 0). Unlike GazeGaussian's, it rotates the Gaussians about the eyeball's own
/// centre, and their own rotations with it.
struct LearnedQuaternion : ExplicitRotation {
    /// Width of the hidden layers.
    static constexpr int hidden = 128;
    /// Number of inputs: the code of pitch and yaw, then 1 for this eye and 0 for the other.
    static constexpr int inputs =
        static_cast<int>(detail::encoded_size(2, detail::default_frequencies)) + 2;

    /// Trained parameters.
    template <class T>
    struct Parameters {
        Mlp<T> turn; ///< inputs to 4: difference from the identity, w x y z
        template <class F, class... P>
        static void fields(F&& f, P&&... p) {
            detail::nested_fields<Mlp<T>>("turn_mlp", f, p.turn...);
        }
    };
    /// Returns PyTorch's default initialisation, with a last layer of zeros.
    template <class P>
    static P init(int, const Random& random) {
        P p{decltype(P::turn)::init({{inputs, hidden, hidden, 4}}, random)};
        p.turn.weight.back().setZero();
        p.turn.bias.back().setZero();
        return p;
    }
    /// Returns the eyeball's rotation, a unit quaternion. `gaze` is a unit vector.
    template <class P, class T>
    static Quat<T> turn(const P& p, std::size_t eye, const Vec3<T>& gaze) {
        const Columns<T> x = input(eye, gaze);
        return quat_normalized<T>(raw(mlp_forward(backend(), p.turn, x, VecX<T>(), nullptr)));
    }
    /// Accumulates the network's gradient; returns the gaze's cotangent.
    template <class P, class T>
    static Vec3<T> turn_vjp(const P& p, std::size_t eye, const Vec3<T>& gaze, const Quat<T>& g_turn,
                            P& grad) {
        const Columns<T> x = input(eye, gaze);
        const VecX<T> none;
        MlpTrace<T> trace;
        const Quat<T> q = raw(mlp_forward(backend(), p.turn, x, none, &trace));
        const Quat<T> g_raw = quat_normalized_vjp<T>(q, g_turn);
        Columns<T> g(4, 1), g_x;
        for (Index i = 0; i < 4; ++i) g(i, 0) = g_raw[i];
        mlp_vjp(backend(), p.turn, {x, none, trace}, g, {grad.turn, &g_x});
        const Index code = x.rows() - 2;
        const Columns<T> g_angles = positional_encoding_vjp(x.topRows(code), g_x.topRows(code));
        return angles_vjp<T>(gaze, Vec2<T>(g_angles(0, 0), g_angles(1, 0)));
    }
    /// Returns the gaze's cotangent, given that of its pitch and yaw.
    template <class T>
    RYE_HD static Vec3<T> angles_vjp(const Vec3<T>& gaze, const Vec2<T>& g_angles) {
        using D = Dual<T, 3>;
        Vec3<D> direction;
        for (int k = 0; k < 3; ++k) direction[k] = D::variable(gaze[k], k);
        const Vec2<D> angles = pitch_yaw(direction);
        Vec3<T> g_gaze(T(0), T(0), T(0));
        for (int k = 0; k < 3; ++k)
            for (int i = 0; i < 2; ++i)
                g_gaze[k] += g_angles[i] * angles[i].d[static_cast<std::size_t>(k)];
        return g_gaze;
    }
    /// Returns the rotation before it is normalised, from the network's four outputs.
    template <class T>
    RYE_HD static Quat<T> raw_turn(const T* y) {
        return Quat<T>(T(1) + y[0], y[1], y[2], y[3]);
    }

  private:
    /// Returns a serial backend: one column is too little work for several threads.
    static ScalarBackend<Serial> backend() { return {}; }
    template <class T>
    static Columns<T> input(std::size_t eye, const Vec3<T>& gaze) {
        Columns<T> x = Columns<T>::Zero(inputs, 1);
        x.topRows(inputs - 2) = encode_gaze(gaze);
        x(inputs - 2 + static_cast<Index>(eye), 0) = T(1);
        return x;
    }
    template <class T>
    static Quat<T> raw(const Columns<T>& y) {
        return raw_turn<T>(y.data());
    }
};
static_assert(GazeMechanism<FixedEye> && GazeMechanism<LearnedQuaternion>);

} // namespace rye
