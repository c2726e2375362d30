// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/smoothness_terms.hpp: the smoothness priors of a step on a device: of the eyes'
/// features (eye_smoothness.hpp) and of the face's (train/face_smoothness.hpp).
#pragma once

#include <rye/train/cuda/eye_smoothness.hpp>
#include <rye/train/face_smoothness.hpp>

namespace rye {

/// The terms whose weights are above 0, with their graphs and memory on the device.
template <DeviceEffects E, class Device>
class DeviceSmoothnessTerms {
  public:
    explicit DeviceSmoothnessTerms(const Device& device)
        : eyes_(device), near_(device), mirror_(device) {}

    /// Copies the graphs of an avatar to the device; waits. Throws an Error for graphs of the face
    /// that do not fit it.
    void set(const CudaQueue& queue, const TwoStream<float, E>& avatar,
             const AvatarLossConfig& weights, const FaceNeighbours& face) {
        weights_ = weights;
        detail::require_face_neighbours(weights, face, avatar.face.position.cols());
        if (weights.eye_smooth > 0)
            eyes_.set(queue, avatar.eyes, avatar.upsampler.shape.in_channels);
        if (weights.face_smooth > 0) near_.set(queue, face.near);
        if (weights.face_mirror > 0) mirror_.set(queue, face.mirror);
    }
    /// Enqueues the terms of a driven avatar, and hands them to `losses`, between its into() and
    /// report_into(). Adds the cotangents of parameters to their gradient; keeps that of the eyes'
    /// generated features for add_into.
    template <class Avatar, class Losses>
    void into(const CudaQueue& queue, const Avatar& avatar,
              const typename Avatar::Parameters& gradient, Losses& losses) {
        if (weights_.eye_smooth > 0)
            losses.add_eye_smooth(eyes_.into(queue, avatar, weights_.eye_smooth, gradient));
        if (!(weights_.face_smooth > 0 || weights_.face_mirror > 0)) return;
        const Columns<float>& features = face_features(avatar.shapes().face);
        const auto term = [&](DeviceSmoothness<Device>& of, double weight) {
            if (!(weight > 0)) return DeviceLossTerm{};
            return of.into(queue, avatar.parameters().of(features), weight, gradient.of(features));
        };
        const DeviceLossTerm near = term(near_, weights_.face_smooth);
        losses.add_face(near, term(mirror_, weights_.face_mirror));
    }
    /// Adds the kept cotangent to that of the eyes' features, C x P, if there is one.
    void add_into(const CudaQueue& queue, const DeviceColumns<float>& g_feature) {
        if (weights_.eye_smooth > 0) eyes_.add_into(queue, g_feature);
    }
    /// Returns the memory held [bytes].
    std::size_t bytes() const { return eyes_.bytes() + near_.bytes() + mirror_.bytes(); }

  private:
    AvatarLossConfig weights_;
    detail::DeviceEyeSmoothness<E, Device> eyes_;
    DeviceSmoothness<Device> near_, mirror_; ///< of the face
};

} // namespace rye
