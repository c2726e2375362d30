// SPDX-License-Identifier: Apache-2.0
/// rye/train/label_unknowns.hpp: what is unknown of a frame's labels (gazes, head pose,
/// expression), its priors, and the photographs that tell it.
#pragma once

#include <array>
#include <vector>

#include <rye/avatar/drivers.hpp>
#include <rye/core/columns.hpp>
#include <rye/geometry/camera.hpp>
#include <rye/rig/gaze.hpp>

namespace rye {

/// Unknowns of a frame and the standard deviations of their priors.
struct LabelUnknowns {
    bool gaze = true;              ///< pitch and yaw of both eyes, 4 unknowns
    bool pose = true;              ///< axis-angle and translation, 6 unknowns
    std::vector<Index> expression; ///< refined coefficients, ascending
    double gaze_sigma = 0.07;      ///< angle of a gaze [rad]
    double rotation_sigma = 0.0175; ///< entry of the axis-angle [rad]
    double translation_sigma = 0.02; ///< coordinate of the translation [world unit]
    double expression_sigma = 0.1; ///< coefficient of the expression

    Index gaze_count() const { return gaze ? 4 : 0; }
    Index pose_count() const { return pose ? 6 : 0; }
    /// Returns the number of unknowns, n: the gazes' (left pitch, yaw, right pitch, yaw), the
    /// pose's, the expression's.
    Index count() const {
        return gaze_count() + pose_count() + static_cast<Index>(expression.size());
    }
    /// Returns the standard deviations of the unknowns, n.
    VecX<double> sigma() const {
        VecX<double> s(count());
        s.head(gaze_count()).setConstant(gaze_sigma);
        if (pose) {
            s.segment(gaze_count(), 3).setConstant(rotation_sigma);
            s.segment(gaze_count() + 3, 3).setConstant(translation_sigma);
        }
        s.tail(static_cast<Index>(expression.size())).setConstant(expression_sigma);
        return s;
    }
};

namespace detail {

/// Returns the direction after changes of its pitch and yaw [rad].
template <Scalar T>
Vec3<T> moved_gaze(const Vec3<T>& gaze, const T& pitch, const T& yaw) {
    const Vec2<T> angles = pitch_yaw(gaze);
    return gaze_vector<T>(angles[0] + pitch, angles[1] + yaw);
}

} // namespace detail

/// Returns the drivers after changes, n, in the order of LabelUnknowns.
template <class T, EffectSet E, class Change>
Drivers<T, E> moved_drivers(const Drivers<T, E>& label, const LabelUnknowns& u,
                            const Eigen::MatrixBase<Change>& change) {
    Drivers<T, E> d = label;
    const auto at = [&](Index k) { return T(change[k]); };
    Index k = 0;
    if (u.gaze)
        for (std::size_t eye = 0; eye < 2; ++eye, k += 2)
            d.gaze[eye] = detail::moved_gaze<T>(label.gaze[eye], at(k), at(k + 1));
    if (u.pose)
        for (Index i = 0; i < 6; ++i) d.pose[i] += at(k++);
    for (const Index i : u.expression) d.expression[i] += at(k++);
    return d;
}

/// Photograph of a frame: colours on the background, and weights of pixels.
template <class T>
struct LabelView {
    Pinhole<T> camera;
    Columns<T> truth;      ///< 3 x pixels
    Columns<T> weight;     ///< 1 x pixels, 0..1
    Vec3<T> background{T(1), T(1), T(1)};
};

} // namespace rye
