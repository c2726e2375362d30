// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/gaze_mechanisms.hpp: an eyeball's learned rotation (LearnedQuaternion of
/// rig/gaze_mechanisms.hpp) in device memory: a network of one column for each eye, once a frame.
#pragma once

#include <memory>

#include <rye/avatar/cuda/gaze_features.hpp>
#include <rye/nn/cuda/mlp_column.hpp>

namespace rye {

namespace detail {

/// Input i of an eye's network: codes of pitch and yaw, and which eye it is.
struct TurnInputs {
    static constexpr const char* name = "inputs of learned turns";
    EncodeGazeAngle angle; ///< LearnedQuaternion::inputs apart

    RYE_DEVICE void operator()(Index i) const { // angle i % 2 of eye i / 2
        angle(i);
        float* const which = angle.code + i / 2 * angle.apart + angle.apart - 2;
        which[i % 2] = i / 2 == i % 2 ? 1.0F : 0.0F;
    }
};

/// The rotation of eye i by its network's outputs.
struct NormalizeTurn {
    static constexpr const char* name = "learned turns";
    const float* output[2]; ///< null for an eye that does not turn
    float* turn;            ///< 4 x 2

    RYE_DEVICE void operator()(Index i) const {
        if (output[i] != nullptr)
            put_column<4>(quat_normalized(LearnedQuaternion::raw_turn(output[i])), turn, i);
    }
};

/// The cotangent of the outputs of eye i.
struct NormalizeTurnVjp {
    static constexpr const char* name = "learned turns, reverse";
    NormalizeTurn turn;
    DeviceTurnSums sums;
    float* g_output; ///< 4 x 2

    RYE_DEVICE void operator()(Index i) const {
        const float* const sum = sums.of[i];
        if (sum == nullptr) return;
        Mat3<float> g_matrix;
        for (int k = 0; k < 9; ++k) g_matrix.data()[k] = sum[k];
        const Quat<float> g = turn_cotangent_of<float>(
            column4(turn.turn, i), g_matrix, Quat<float>(sum[9], sum[10], sum[11], sum[12]));
        put_column<4>(quat_normalized_vjp(LearnedQuaternion::raw_turn(turn.output[i]), g), g_output,
                      i);
    }
};

/// Adds the cotangent of the optical axis of eye i.
struct TurnInputsVjp {
    static constexpr const char* name = "inputs of learned turns, reverse";
    EncodeGazeAngle angle;
    const float* g; ///< of the inputs
    float* g_axis;  ///< 3 x 2, added to

    RYE_DEVICE void operator()(Index i) const {
        const int eye = static_cast<int>(i);
        if (!angle.gazes.turns[eye]) return;
        const Index at = i * angle.apart;
        Vec2<float> g_angles;
        for (int k = 0; k < 2; ++k)
            g_angles[k] =
                encode_number_vjp(angle.code + at + k, g + at + k, default_frequencies, 2);
        add_column<3>(LearnedQuaternion::angles_vjp(angle.gazes.unit(eye), g_angles), g_axis, i);
    }
};

} // namespace detail

/// LearnedQuaternion.
template <class Device>
class DeviceGazeMechanism<LearnedQuaternion, Device> {
    using Network = DeviceMlpColumn<Device>;

  public:
    using Parameters = LearnedQuaternion::Parameters<float>;
    DeviceGazeMechanism(const Device& device, const Parameters& host)
        : device_(device),
          host_(&host) {
        for (auto& n : turn_) n = std::make_unique<Network>(device, host.turn.shape);
    }

    template <class Of>
    void set(const CudaQueue& queue, const Of& of) {
        numbers_.reserve(queue, std::size_t(2 * (inputs + 4 + 4 + inputs)));
        for (int eye = 0; eye < 2; ++eye)
            turn_[eye]->set(queue, device_parameters(host_->turn, of),
                            numbers_.data() + eye * inputs);
    }
    void turn_into(const CudaQueue& queue, const DeviceEyeFrame& frame) {
        launch_each(device_, queue, 4, detail::TurnInputs{angles(frame)});
        for (int eye = 0; eye < 2; ++eye)
            if (frame.gazes.turns[eye]) turn_[eye]->forward_into(queue);
        launch_each(device_, queue, 2, normalize(frame));
    }
    const float* turns() const { return numbers_.data() + 2 * inputs; }
    template <class To>
    void vjp_into(const CudaQueue& queue, const To& to, const DeviceEyeFrame& frame,
                  const DeviceTurnSums& sums) {
        float *const g_output = numbers_.data() + 2 * (inputs + 4), *const g_input = g_output + 8;
        launch_each(device_, queue, 2, detail::NormalizeTurnVjp{normalize(frame), sums, g_output});
        const DeviceMlpParameters gradient = device_parameters(host_->turn, to);
        for (int eye = 0; eye < 2; ++eye)
            if (frame.gazes.turns[eye])
                turn_[eye]->vjp_into(queue, g_output + 4 * eye, gradient, g_input + eye * inputs);
        if (frame.g_axis != nullptr)
            launch_each(device_, queue, 2,
                        detail::TurnInputsVjp{angles(frame), g_input, frame.g_axis});
    }
    std::size_t bytes() const { return turn_[0]->bytes() + turn_[1]->bytes() + numbers_.bytes(); }

  private:
    static constexpr int inputs = LearnedQuaternion::inputs;
    detail::EncodeGazeAngle angles(const DeviceEyeFrame& frame) const {
        return {frame.gazes, numbers_.data(), inputs};
    }
    detail::NormalizeTurn normalize(const DeviceEyeFrame& frame) const {
        const auto output = [&](int eye) {
            return frame.gazes.turns[eye] ? turn_[eye]->outputs() : nullptr;
        };
        return {{output(0), output(1)}, numbers_.data() + 2 * inputs};
    }

    Device device_;
    const Parameters* host_;
    std::unique_ptr<Network> turn_[2]; ///< the same parameters, a column for each eye
    DeviceBuffer<float> numbers_; ///< inputs, turns, cotangents of outputs, of inputs; left, right
};

} // namespace rye
