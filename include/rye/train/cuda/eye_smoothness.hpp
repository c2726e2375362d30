// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/eye_smoothness.hpp: smoothness of the eyes' features as a term of a step on a
/// device: of parameters if features are constants, else of the frame's generated features, whose
/// cotangent is added to the cloud's. AvatarTrainer of train/avatar_trainer.hpp does the same.
#pragma once

#include <rye/avatar/cuda/two_stream.hpp>
#include <rye/loss/cuda/smoothness.hpp>
#include <rye/train/avatar_trainer.hpp>

namespace rye {

/// Smoothness term of an avatar's eyes, with its graph and memory on the device.
template <DeviceEffects E, class Device>
class DeviceEyeSmoothness {
    using Host = TwoStream<float, E>;
    /// True if features are constants.
    static constexpr bool of_parameters = requires(const Host& a) { a.eyes.feature; };
    struct FeaturesAreConstants {};

  public:
    explicit DeviceEyeSmoothness(const Device& device) : device_(device), term_(device) {}

    /// Copies the neighbours of each point to the device, and reserves memory for features of
    /// `channels`; waits.
    void set(const CudaQueue& queue, const EyeStream<float, E>& eyes,
             [[maybe_unused]] Index channels) {
        const auto points = static_cast<std::size_t>(eyes.position.cols());
        term_.set(queue, queue.idle ? NeighbourGraph(points) : eye_neighbours(eyes)); // O(P^2)
        if constexpr (!of_parameters)
            g_.reserve(queue, static_cast<std::size_t>(channels * eyes.position.cols()) + 1);
    }
    /// Enqueues the term of a driven avatar. Adds the cotangent of parameters to their gradient;
    /// keeps that of generated features for add_into.
    template <class Avatar>
    DeviceLossTerm into(const CudaQueue& queue, const Avatar& avatar, double weight,
                        [[maybe_unused]] const typename Avatar::Parameters& gradient) {
        if constexpr (of_parameters) {
            const Columns<float>& feature = avatar.shapes().eyes.feature;
            return term_.into(queue, avatar.parameters().of(feature), weight, gradient.of(feature));
        } else {
            const DeviceColumns<float> feature = avatar.eye_gaussians().feature;
            device_.fill(queue, g_.data(), 0,
                         static_cast<std::size_t>(feature.size()) * sizeof(float));
            return term_.into(queue, feature, weight, {g_.data(), feature.rows, feature.cols});
        }
    }
    /// Adds the kept cotangent to that of the eyes' features, C x P; does nothing if features are
    /// constants.
    void add_into([[maybe_unused]] const CudaQueue& queue,
                  [[maybe_unused]] const DeviceColumns<float>& g_feature) {
        if constexpr (!of_parameters)
            launch_each(device_, queue, g_feature.size(), AddNumbers{g_.data(), g_feature.data});
    }
    /// Returns the memory held [bytes].
    std::size_t bytes() const {
        std::size_t sum = term_.bytes();
        if constexpr (!of_parameters) sum += g_.bytes();
        return sum;
    }

  private:
    Device device_;
    DeviceSmoothness<Device> term_;
    [[no_unique_address]] PresentIf<!of_parameters, FeaturesAreConstants, DeviceBuffer<float>> g_;
};

} // namespace rye
