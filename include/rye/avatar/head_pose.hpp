// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/head_pose.hpp: Gaussians from the head frame to the world, with vjp.
/// x_world = S R x + T, q_world = q_R (x) q, scale_world = S scale. Source: GHA, generate(), step 7
/// (quaternions are composed, not converted through matrices; numerics C12).
#pragma once

#include <array>

#include <rye/autodiff/dual.hpp>
#include <rye/avatar/drivers.hpp>
#include <rye/gaussian/gaussians.hpp>
#include <rye/math/rotation.hpp>

namespace rye {

/// The world from the head frame: x_world = scale rotation x + translation.
template <class T>
struct HeadTransform {
    Mat3<T> rotation;
    Vec4<T> quaternion;
    Vec3<T> translation;
    T scale;
};

/// The transform of a pose (axis-angle, translation) and a scale.
template <class T>
RYE_HD HeadTransform<T> head_transform(const Vec<T, 6>& pose, const T& scale) {
    const Mat3<T> rotation = so3_exp(Vec3<T>(pose[0], pose[1], pose[2]));
    return {rotation, matrix_quat(rotation), Vec3<T>(pose[3], pose[4], pose[5]), scale};
}

namespace detail {

/// The head's transform of an avatar that has one.
template <class T, EffectSet E = PaperEffects>
using HeadSlot = Slot<E, HeadPose, HeadTransform<T>>;

} // namespace detail

/// The transform of the drivers' head pose and scale.
template <class T, EffectSet E>
    requires has_effect<E, HeadPose>
HeadTransform<T> head_transform(const Drivers<T, E>& drivers) {
    return head_transform<T>(drivers.pose, drivers.scale);
}

/// The column of TwoStream::delta_view that moves a picture's head, -1 for none, and the point that
/// it is turned about [world].
template <class T>
struct SeenBy {
    Index column = -1;
    Vec3<T> pivot = Vec3<T>::Zero();
};

namespace detail {

/// The head as a picture shows it: turned about the pivot, then moved, by `view`, which is the
/// head_transform of a column of TwoStream::delta_view.
template <class T>
RYE_HD HeadTransform<T> seen_head(const HeadTransform<T>& view, const Vec3<T>& pivot,
                                  const HeadTransform<T>& head) {
    return {view.rotation * head.rotation, quat_product<T>(view.quaternion, head.quaternion),
            view.rotation * (head.translation - pivot) + pivot + view.translation, head.scale};
}

} // namespace detail

/// One Gaussian's mean in the world; `scaled`: the head's scale times its rotation.
template <class T>
RYE_HD Vec3<T> mean_to_world(const HeadTransform<T>& head, const Mat3<T>& scaled,
                             const Vec3<T>& mean) {
    return scaled * mean + head.translation;
}

/// Moves the first N means and rotations to the world, in place, and sets their scales there from
/// those in the head frame, 3 x N, which may be the same array.
template <class T, Backend B>
void to_world(const B& backend, const HeadTransform<T>& head, const Columns<T>& scale,
              Gaussians<T>& g) {
    for_chunks(backend.threads, scale.cols(), 512, [&](Index b, Index e, Index) {
        const Mat3<T> sr = head.scale * head.rotation;
        for (Index i = b; i < e; ++i) {
            const Vec3<T> x = g.mean.col(i);
            const Vec4<T> q = g.rotation.col(i);
            g.mean.col(i) = mean_to_world(head, sr, x);
            g.rotation.col(i) = quat_product<T>(head.quaternion, q);
        }
        g.scale.middleCols(b, e - b) = scale.middleCols(b, e - b) * head.scale;
    });
}

namespace detail {

/// Parts of a Gaussian that the head's motion moves.
template <class T>
struct MovedPoint {
    Vec3<T> mean;
    Vec4<T> rotation;
};

} // namespace detail

/// Cotangents of a HeadTransform's parts.
template <class T>
struct HeadTransformGradient {
    Mat3<T> rotation = Mat3<T>::Zero();
    Vec4<T> quaternion = Vec4<T>::Zero();
    Vec3<T> translation = Vec3<T>::Zero();

    HeadTransformGradient& operator+=(const HeadTransformGradient& b) {
        rotation += b.rotation;
        quaternion += b.quaternion;
        translation += b.translation;
        return *this;
    }
    /// Adds one Gaussian's, whose cotangents it takes from the world into the head's frame.
    RYE_HD void add(const HeadTransform<T>& head, const detail::MovedPoint<T>& world,
                    detail::MovedPoint<T>& g) {
        const Vec3<T> gx = g.mean;
        const Vec3<T> centred = world.mean - head.translation;
        const Vec3<T> scaled = head.rotation.transpose() * centred; // S x
        rotation += gx * scaled.transpose();
        translation += gx;
        const Vec4<T> q = quat_product<T>(quat_conjugate<T>(head.quaternion), world.rotation);
        quaternion += quat_product_vjp_left<T>(q, g.rotation);
        g.rotation = quat_product_vjp_right<T>(head.quaternion, g.rotation);
        g.mean = head.scale * (head.rotation.transpose() * gx);
    }
};

namespace detail {

/// Cotangents of the two transforms that seen_head joins.
template <class T>
struct SeenHeadGradient {
    HeadTransformGradient<T> view, head;
};

/// The vjp of seen_head, given the cotangent of its result.
template <class T>
RYE_HD SeenHeadGradient<T> seen_head_vjp(const HeadTransform<T>& view, const Vec3<T>& pivot,
                                         const HeadTransform<T>& head,
                                         const HeadTransformGradient<T>& g) {
    SeenHeadGradient<T> r;
    r.view.rotation = g.rotation * head.rotation.transpose() +
                      g.translation * (head.translation - pivot).transpose();
    r.view.quaternion = quat_product_vjp_left<T>(head.quaternion, g.quaternion);
    r.view.translation = g.translation;
    r.head.rotation = view.rotation.transpose() * g.rotation;
    r.head.quaternion = quat_product_vjp_right<T>(view.quaternion, g.quaternion);
    r.head.translation = view.rotation.transpose() * g.translation;
    return r;
}

/// Numbers that a HeadTransformGradient is summed as: rotation, quaternion, translation.
inline constexpr int head_sums = 16;

/// Adds a gradient to sums, from the first on.
template <class T, class Sums>
RYE_HD void add_head_sums(const HeadTransformGradient<T>& g, Sums& sum, int from) {
    const auto at = [from](int k) { return static_cast<std::size_t>(from + k); };
    for (int k = 0; k < 9; ++k) sum[at(k)] += g.rotation.data()[k];
    for (int k = 0; k < 4; ++k) sum[at(9 + k)] += g.quaternion[k];
    for (int k = 0; k < 3; ++k) sum[at(13 + k)] += g.translation[k];
}
/// Adds such sums to a gradient.
template <class T>
RYE_HD void take_head_sums(const T* sum, HeadTransformGradient<T>& g) {
    for (int k = 0; k < 9; ++k) g.rotation.data()[k] += sum[k];
    for (int k = 0; k < 4; ++k) g.quaternion[k] += sum[9 + k];
    for (int k = 0; k < 3; ++k) g.translation[k] += sum[13 + k];
}

} // namespace detail

/// Turns the range's world cotangents in `g` into head-frame ones, in place. Returns the cotangent
/// of the transform.
template <class T, Backend B>
HeadTransformGradient<T> to_world_vjp(const B& backend, const HeadTransform<T>& head,
                                      const Gaussians<T>& world, detail::ColumnRange range,
                                      Gaussians<T>& g) {
    return sum_chunks(backend.threads, range.count, 512, HeadTransformGradient<T>{},
                      [&](Index b, Index e) {
                          HeadTransformGradient<T> sum;
                          for (Index i = range.begin + b; i < range.begin + e; ++i) {
                              detail::MovedPoint<T> own{g.mean.col(i), g.rotation.col(i)};
                              sum.add(head, {world.mean.col(i), world.rotation.col(i)}, own);
                              g.mean.col(i) = own.mean;
                              g.rotation.col(i) = own.rotation;
                          }
                          g.scale.middleCols(range.begin + b, e - b) *= head.scale;
                          return sum;
                      });
}

/// Cotangent of pose from that of the transform: the Jacobian of the exponential map by duals.
template <class T>
RYE_HD Vec<T, 6> head_pose_vjp(const Vec<T, 6>& pose, const HeadTransformGradient<T>& g) {
    using D = Dual<T, 3>;
    Vec3<D> w;
    for (int i = 0; i < 3; ++i) w(i) = D::variable(pose(i), i);
    const Mat3<D> r = so3_exp(w);
    const Vec4<D> q = matrix_quat(r);
    Vec<T, 6> g_pose;
    for (int k = 0; k < 3; ++k) {
        const std::size_t kk = static_cast<std::size_t>(k);
        T sum = T(0);
        for (int i = 0; i < 9; ++i) sum += g.rotation(i / 3, i % 3) * r(i / 3, i % 3).d[kk];
        for (int i = 0; i < 4; ++i) sum += g.quaternion(i) * q(i).d[kk];
        g_pose(k) = sum;
    }
    for (int k = 0; k < 3; ++k) g_pose(3 + k) = g.translation(k);
    return g_pose;
}
/// The same, of drivers.
template <class T, EffectSet E>
    requires has_effect<E, HeadPose>
Vec<T, 6> head_pose_vjp(const Drivers<T, E>& drivers, const HeadTransformGradient<T>& g) {
    return head_pose_vjp<T>(drivers.pose, g);
}

} // namespace rye
