// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/eye_parts.hpp: parts of an avatar's eyes (rig/parts.hpp) in device memory: what
/// turns an eyeball, and what gives its Gaussians their features. A part has kernels where
/// DeviceGazeMechanism or DeviceEyeAppearance is specialised for it and part_has_kernels says so.
/// Here are those whose kernels are copies and sums, or none; gaze_mechanisms.hpp and
/// gaze_features.hpp of this folder have others. Frames: as in rig/gaze_mechanism.hpp.
#pragma once

#include <string>
#include <type_traits>
#include <utility>

#include <rye/avatar/cuda/face_points.hpp>
#include <rye/nn/cuda/mlp.hpp>

namespace rye {

namespace detail {

/// Optical axes of a frame as parts of the eyes read them: unit vectors in the head's frame, +z for
/// an eye that does not turn.
struct DeviceGazes {
    const DeviceFrameState* frame;
    bool turns[2]; ///< left, right

    RYE_HD Vec3<float> unit(int eye) const {
        return turns[eye] ? normalized(frame->optical[eye]) : Vec3<float>(0.0F, 0.0F, 1.0F);
    }
    /// The smallest rotation from +z.
    RYE_HD Mat3<float> rotation(int eye) const {
        return quat_matrix(shortest_arc(Vec3<float>(0.0F, 0.0F, 1.0F), unit(eye)));
    }
};

} // namespace detail

/// A frame as parts of the eyes read it, in device memory, and where cotangents of it go.
struct DeviceEyeFrame {
    detail::DeviceGazes gazes;
    bool reads_pose = false;           ///< whether an effect reads the head pose
    const float* expression = nullptr; ///< its code, or null where no effect reads it
    float* g_axis = nullptr;           ///< of the optical axes, 3 x 2, added to, or null
    float* g_pose = nullptr;           ///< of the head pose, 6, added to, or null
};

/// The eyeballs' points at rest, on the host.
struct EyeballPoints {
    const Columns<float>& position; ///< about their centre, 3 x P; the left eye's first
    Index left;                     ///< number of the left eye's

    Index first(int eye) const { return eye == 0 ? 0 : left; }
    Index count(int eye) const { return eye == 0 ? left : position.cols() - left; }
};

namespace detail {

/// Columns of an eye of an array with a column a point.
template <class T>
DeviceColumns<T> columns_of_eye(const DeviceColumns<T>& a, int eye, Index left) {
    return {eye == 0 ? a.data : a.data + left * a.rows, a.rows, eye == 0 ? left : a.cols - left};
}

} // namespace detail

/// Sums over the points of each eye that the cotangent of its turn is made of: of the matrix (9, as
/// Mat3 has them), then of the quaternion (4). Null for an eye that does not turn.
struct DeviceTurnSums {
    const float* of[2];
};

/// An object that turns eyeballs by the mechanism M on a device, with the functions that FixedEye's
/// has below. Explicit rotation has none: the kernel that places the eyes does it.
template <class M, class Device>
class DeviceGazeMechanism;

/// Eyeballs that keep still.
template <class Device>
class DeviceGazeMechanism<FixedEye, Device> {
  public:
    using Parameters = FixedEye::Parameters<float>;
    DeviceGazeMechanism(const Device&, const Parameters&) {}

    /// Takes memory for what a frame needs, and where the parameters lie.
    template <class Of>
    void set(const CudaQueue&, const Of&) {}
    /// Puts the turns of a frame on the stream.
    void turn_into(const CudaQueue&, const DeviceEyeFrame&) {}
    /// Those: unit quaternions, 4 x 2; null for the rotation by nothing.
    const float* turns() const { return nullptr; }
    /// Adds the gradients of parameters, and the cotangents of the frame's axes.
    template <class To>
    void vjp_into(const CudaQueue&, const To&, const DeviceEyeFrame&, const DeviceTurnSums&) {}
    /// Memory that is held [bytes].
    std::size_t bytes() const { return 0; }
};

namespace detail {

/// True if an appearance gives the cotangents of its inputs: EyeInputsCotangent.
template <EyeAppearance A, class P = typename A::template Parameters<float>>
inline constexpr bool gives_cotangents = !std::is_void_v<decltype(A::features_vjp(
    0, std::declval<const P&>(), std::declval<const EyeInputs<float>&>(),
    std::declval<const ColumnsView<float>&>(), std::declval<P&>()))>;

} // namespace detail

/// Features of the eyeballs' Gaussians by the appearance A on a device, as an object with the
/// functions of FreeFeatures' below. Networks: tiles of its networks, as DeviceNetworks has them.
template <class A, class Device, class Networks>
class DeviceEyeAppearance;

/// Trained constants.
template <class Device, class Networks>
class DeviceEyeAppearance<FreeFeatures, Device, Networks> {
  public:
    using Parameters = FreeFeatures::Parameters<float>;
    /// `host` must stay where it is: its arrays are found by their addresses. `scratch` is shared
    /// by networks that run one after the other.
    DeviceEyeAppearance(const Device& device, const Parameters& host, DeviceMlpScratch&)
        : device_(device),
          host_(&host) {}

    /// Takes what is not trained. Waits. Throws an Error for parameters of other points.
    void set_fixed(const CudaQueue&, const EyeballPoints&) {}
    /// Takes the parameters, and the frame.
    template <class Of>
    void set(const CudaQueue&, const Of&, const DeviceEyeFrame&) {}
    /// The frame has changed, and nothing else.
    template <class Of>
    void set_frame(const CudaQueue&, const Of&, const DeviceEyeFrame&) {}
    /// Puts the features, C x P, on the stream. `keep`: what a vjp reads.
    template <class Of>
    void features_into(const CudaQueue& queue, const Of& of, const DeviceEyeFrame&,
                       const DeviceColumns<float>& feature, bool) {
        launch_each(device_, queue, feature.size(),
                    detail::CopyNumbers{of(host_->feature).data, feature.data});
    }
    /// Adds the gradients of parameters, given the cotangent of the features, and the cotangents
    /// of the frame.
    template <class Of, class To>
    void vjp_into(const CudaQueue& queue, const Of&, const To& to, const DeviceEyeFrame&,
                  const DeviceColumns<float>& g) {
        launch_each(device_, queue, g.size(), detail::AddNumbers{g.data, to(host_->feature).data});
    }
    /// Memory that is held, without what is shared [bytes].
    std::size_t bytes() const { return 0; }

  private:
    Device device_;
    const Parameters* host_;
};

namespace detail {

/// Throws an Error unless an array of an eye appearance has this shape.
inline void require_eye_array(const std::string& name, const Columns<float>& a, Index rows,
                              Index cols) {
    require(a.rows() == rows && a.cols() == cols, "DeviceEyeAppearance", name, " is ", a.rows(),
            " x ", a.cols(), ", expected ", rows, " x ", cols);
}

} // namespace detail

} // namespace rye
