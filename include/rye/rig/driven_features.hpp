// SPDX-License-Identifier: Apache-2.0
/// rye/rig/driven_features.hpp: features of the eyeballs' Gaussians that the frame drives: trained
/// constants plus, for each eye, a small network of the point's direction at rest and turned by the
/// gaze, the gaze, the head's rotation and the expression. Highlights and the shadow of the lids
/// thus need not turn with the eyeball.
/// Frames: the eyeball's for template points, the head's for turned points and gazes.
/// Source: paper section 3.2, the eye stream's "dedicated dynamic generator", whose inputs and size
/// it does not give.
#pragma once

#include <array>

#include <rye/autodiff/dual.hpp>
#include <rye/math/rotation.hpp>
#include <rye/nn/encoding.hpp>
#include <rye/nn/mlp.hpp>
#include <rye/rig/eye_appearance.hpp>

namespace rye {

/// An EyeAppearance, selected by EyesBy<DrivenFeatures>. The networks' last layers start at 0, so
/// that training starts with the picture of FreeFeatures; the weights of gaze, head rotation and
/// expression start at 0, so that a driver that is constant in training has no effect later.
/// Without networks (default-constructed ones) the features are the constants.
struct DrivenFeatures {
    static constexpr bool reads_inputs = true;
    static constexpr int frequencies = 3; ///< octaves of the encoding of directions
    static constexpr int width = 48;      ///< width of both hidden layers

    /// Trained parameters.
    template <class T>
    struct Parameters {
        Columns<T> feature;             ///< C x P: left eye, then right
        std::array<Mlp<T>, 2> networks; ///< left, right: inputs to C
        template <class F, class... P>
        static void fields(F&& f, P&&... p) {
            f("feature", p.feature...);
            detail::nested_fields<Mlp<T>>("left_appearance_mlp", f, p.networks[0]...);
            detail::nested_fields<Mlp<T>>("right_appearance_mlp", f, p.networks[1]...);
        }
    };
    /// Returns the number of a network's inputs for a point: codes of its direction from the
    /// eyeball's centre, at rest and turned.
    static constexpr Index point_inputs() { return 2 * detail::encoded_size(3, frequencies); }
    /// Returns the shape of each network.
    static MlpShape shape(const AppearanceSizes& sizes) {
        const int frame = 3 + (sizes.pose > 0 ? 3 : 0) + sizes.expression;
        return {{static_cast<int>(point_inputs()) + frame, width, width, sizes.channels}, frame};
    }
    /// Returns the constants of FreeFeatures, and networks whose output is 0.
    template <class P>
    static P init(const AppearanceSizes& sizes, const Random& random) {
        using T = typename decltype(P::feature)::Scalar;
        P p;
        p.feature =
            FreeFeatures::init<FreeFeatures::Parameters<T>>(sizes.channels, sizes.points, random)
                .feature;
        const MlpShape s = shape(sizes);
        for (std::size_t eye = 0; eye < 2; ++eye) {
            Mlp<T>& mlp = p.networks[eye] = Mlp<T>::init(s, random.fork(eye + 1));
            for (int l = 0; l < s.layers(); ++l)
                if (s.reads_input(l))
                    mlp.weight[static_cast<std::size_t>(l)].rightCols(s.frame_inputs).setZero();
            mlp.weight.back().setZero();
            mlp.bias.back().setZero();
        }
        return p;
    }
    /// Returns true if an eye (0: the left) has a network, so that the frame drives its features.
    template <class P>
    static bool driven(const P& p, std::size_t eye) {
        return !p.networks[eye].weight.empty();
    }
    /// Writes the features, C x P, whole columns and contiguous.
    template <class B, class P, class T>
    static void features(const B& backend, const P& p, const EyeInputs<T>& in,
                         ColumnsSpan<T> feature) {
        for (std::size_t eye = 0; eye < 2; ++eye) eye_features(backend, p, in, eye, feature);
    }
    /// Writes the features of one eye's columns; leaves the other eye's unchanged.
    template <class B, class P, class T>
    static void eye_features(const B& backend, const P& p, const EyeInputs<T>& in, std::size_t eye,
                             ColumnsSpan<T> feature) {
        const Index rows = p.feature.rows(), first = eye == 0 ? 0 : in.left_points,
                    n = eye == 0 ? in.left_points : p.feature.cols() - in.left_points;
        Eigen::Map<Columns<T>> to(feature.data() + first * rows, rows, n);
        to = p.feature.middleCols(first, n);
        if (!driven(p, eye)) return;
        const Evaluated<T> x(in, eye);
        to += mlp_forward<T>(backend, p.networks[eye], x.points, x.frame, nullptr);
    }
    /// Accumulates the parameters' gradient from the features' cotangent; returns the inputs'
    /// cotangent.
    template <class B, class P, class T>
    static detail::EyeInputsCotangent<T> features_vjp(const B& backend, const P& p,
                                                      const EyeInputs<T>& in,
                                                      const ColumnsView<T>& g, P& grad) {
        detail::EyeInputsCotangent<T> g_in;
        grad.feature += g;
        for (std::size_t eye = 0; eye < 2; ++eye) {
            if (!driven(p, eye)) continue;
            const Evaluated<T> x(in, eye);
            MlpTrace<T> trace;
            mlp_forward<T>(backend, p.networks[eye], x.points, x.frame, &trace);
            Columns<T> g_points;
            VecX<T> g_frame;
            mlp_vjp<T>(backend, p.networks[eye], {x.points, x.frame, trace},
                       g.middleCols(x.first, x.direction.cols()),
                       {grad.networks[eye], &g_points, &g_frame});
            g_in.gaze[eye] = x.gaze_vjp(g_points, g_frame);
            if (in.pose.size() > 0) g_in.pose.template head<3>() += g_frame.template segment<3>(3);
        }
        return g_in;
    }
    /// Returns the directions of points from the eyeball's centre, unit, 3 x n.
    template <class T>
    static Columns<T> directions(const Columns<T>& position) {
        Columns<T> d(3, position.cols());
        for (Index i = 0; i < d.cols(); ++i) d.col(i) = normalized(Vec3<T>(position.col(i)));
        return d;
    }
    /// Returns the smallest rotation from +z to a unit gaze.
    template <class T>
    RYE_HD static Mat3<T> turn_of(const Vec3<T>& unit) {
        return quat_matrix(shortest_arc(Vec3<T>(T(0), T(0), T(1)), unit));
    }
    /// Returns the cotangent of a gaze of any length, given those of its turn_of and its direction.
    template <class T>
    RYE_HD static Vec3<T> gaze_vjp(const Vec3<T>& gaze, const Mat3<T>& g_turn,
                                   const Vec3<T>& g_unit) {
        using D = Dual<T, 3>;
        Vec3<D> v;
        for (int k = 0; k < 3; ++k) v[k] = D::variable(gaze[k], k);
        const Vec3<D> unit = normalized(v);
        const Mat3<D> turn = turn_of(unit);
        Vec3<T> sum(T(0), T(0), T(0));
        for (int k = 0; k < 3; ++k) {
            const std::size_t by = static_cast<std::size_t>(k);
            for (int i = 0; i < 9; ++i) sum[k] += g_turn(i / 3, i % 3) * turn(i / 3, i % 3).d[by];
            for (int i = 0; i < 3; ++i) sum[k] += g_unit[i] * unit[i].d[by];
        }
        return sum;
    }

  private:
    /// Inputs of an eye's network.
    template <class T>
    struct Evaluated {
        Index first;          ///< column of the eye's first point
        Vec3<T> gaze;         ///< optical axis, any length
        Columns<T> direction; ///< of the eye's points from its centre at rest, unit, 3 x n
        Columns<T> points;    ///< point_inputs() x n
        VecX<T> frame;        ///< unit gaze, head's axis-angle [rad], expression

        Evaluated(const EyeInputs<T>& in, std::size_t eye)
            : first(eye == 0 ? 0 : in.left_points),
              gaze(in.gaze.col(static_cast<Index>(eye))),
              direction(directions<T>(in.position.middleCols(
                  first, eye == 0 ? in.left_points : in.position.cols() - in.left_points))) {
            const Vec3<T> unit = normalized(gaze);
            const Columns<T> turned = turn_of(unit) * direction;
            points.resize(point_inputs(), direction.cols());
            points << positional_encoding(direction, frequencies),
                positional_encoding(turned, frequencies);
            const Index rotation = in.pose.size() > 0 ? 3 : 0;
            frame.resize(3 + rotation + in.expression.size());
            frame << unit, in.pose.head(rotation), in.expression;
        }
        /// Returns the gaze's cotangent: through the turned points, and as an input.
        Vec3<T> gaze_vjp(const Columns<T>& g_points, const VecX<T>& g_frame) const {
            const Index half = point_inputs() / 2;
            const Columns<T> g_turned = positional_encoding_vjp(
                points.bottomRows(half), g_points.bottomRows(half), frequencies);
            const Mat3<T> g_turn = g_turned * direction.transpose();
            return DrivenFeatures::gaze_vjp<T>(gaze, g_turn,
                                               Vec3<T>(g_frame[0], g_frame[1], g_frame[2]));
        }
    };
};
static_assert(EyeAppearance<DrivenFeatures>);

} // namespace rye
