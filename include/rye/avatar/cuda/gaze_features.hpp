// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/gaze_features.hpp: the eye appearances of rig/gaze_features.hpp in device
/// memory, by their networks over points: rotated triplets of each Gaussian, latents with the
/// gaze's code, places with a rotated code of the eye. What all points of an eye share is part of
/// the biases of the eye's network.
#pragma once

#include <memory>

#include <rye/avatar/cuda/eye_parts.hpp>
#include <rye/nn/encoding.hpp>

namespace rye {

namespace detail {

/// Rotates triplet i of columns of `triplets` by the gaze of their eye.
struct TurnTriplet {
    static constexpr const char* name = "triplets turned";
    const float* from;
    float* to;
    std::uint32_t triplets; ///< a column; all of them are fewer than 2^32
    std::uint32_t left;     ///< columns of the left eye, which come first
    DeviceGazes gazes;

    RYE_HD int eye_of(Index i) const {
        return static_cast<std::uint32_t>(i) / triplets < left ? 0 : 1;
    }
    RYE_DEVICE void operator()(Index i) const {
        put_column<3>(detail::turned_triplet<float>(gazes.rotation(eye_of(i)), column3(from, i)),
                      to, i);
    }
};

/// Adds the cotangent of triplet i before it was rotated.
struct TurnTripletVjp {
    static constexpr const char* name = "triplets turned, reverse";
    TurnTriplet turn; ///< from: the cotangent after; to: added to

    RYE_DEVICE void operator()(Index i) const {
        const Mat3<float> back = turn.gazes.rotation(turn.eye_of(i)).transpose();
        add_column<3>(detail::turned_triplet<float>(back, column3(turn.from, i)), turn.to, i);
    }
};

/// Encodes pitch (i even) or yaw of eye i / 2.
struct EncodeGazeAngle {
    static constexpr const char* name = "codes of gazes";
    DeviceGazes gazes;
    float* code; ///< of eye e from number e apart on
    int apart;

    RYE_DEVICE void operator()(Index i) const {
        const int eye = static_cast<int>(i) / 2, k = static_cast<int>(i) % 2;
        const Vec2<float> angles = pitch_yaw(gazes.unit(eye));
        encode_number(angles[k], default_frequencies, 2, code + eye * apart + k);
    }
};

} // namespace detail

/// RotatedFeatures.
template <class Device, class Networks>
class DeviceEyeAppearance<RotatedFeatures, Device, Networks> {
  public:
    using Parameters = RotatedFeatures::Parameters<float>;
    DeviceEyeAppearance(const Device& device, const Parameters& host, DeviceMlpScratch& scratch)
        : device_(device),
          host_(&host),
          map_(device, host.map.shape) {
        map_.share(scratch);
    }

    void set_fixed(const CudaQueue& queue, const EyeballPoints& points) {
        points_ = points.position.cols();
        left_ = points.left;
        detail::require_eye_array("latent", host_->latent, rows, points_);
        turned_.reserve(queue, static_cast<std::size_t>(rows * points_) + 1);
    }
    template <class Of>
    void set(const CudaQueue& queue, const Of& of, const DeviceEyeFrame&) {
        map_.set(queue, device_parameters(host_->map, of), nullptr);
    }
    template <class Of>
    void set_frame(const CudaQueue&, const Of&, const DeviceEyeFrame&) {}
    template <class Of>
    void features_into(const CudaQueue& queue, const Of& of, const DeviceEyeFrame& frame,
                       const DeviceColumns<float>& feature, bool keep) {
        launch_each(device_, queue, triplets(),
                    turn(of(host_->latent).data, turned_.data(), frame));
        map_.forward_into(queue, DeviceColumns<const float>{turned_.data(), rows, points_}, feature,
                          keep);
    }
    template <class Of, class To>
    void vjp_into(const CudaQueue& queue, const Of&, const To& to, const DeviceEyeFrame& frame,
                  const DeviceColumns<float>& g) {
        g_turned_.reserve(queue, static_cast<std::size_t>(rows * points_) + 1);
        map_.vjp_into(queue, g,
                      {device_parameters(host_->map, to), {g_turned_.data(), rows, points_}});
        launch_each(device_, queue, triplets(),
                    detail::TurnTripletVjp{turn(g_turned_.data(), to(host_->latent).data, frame)});
    }
    std::size_t bytes() const { return map_.bytes() + turned_.bytes() + g_turned_.bytes(); }

  private:
    static constexpr Index rows = RotatedFeatures::latent_size;
    Index triplets() const { return rows / 3 * points_; }
    detail::TurnTriplet turn(const float* from, float* to, const DeviceEyeFrame& frame) const {
        return {from, to, static_cast<std::uint32_t>(rows / 3), static_cast<std::uint32_t>(left_),
                frame.gazes};
    }

    Device device_;
    const Parameters* host_;
    DeviceMlp<Device, typename Networks::OfFeatures> map_;
    Index points_ = 0, left_ = 0;
    DeviceBuffer<float> turned_, g_turned_;
};

/// ConditionedFeatures.
template <class Device, class Networks>
class DeviceEyeAppearance<ConditionedFeatures, Device, Networks> {
    using Network = DeviceMlp<Device, typename Networks::OfFeatures>;

  public:
    using Parameters = ConditionedFeatures::Parameters<float>;
    DeviceEyeAppearance(const Device& device, const Parameters& host, DeviceMlpScratch& scratch)
        : device_(device),
          host_(&host) {
        for (auto& n : color_) {
            n = std::make_unique<Network>(device, host.color.shape);
            n->share(scratch);
        }
    }

    void set_fixed(const CudaQueue& queue, const EyeballPoints& points) {
        left_ = points.left;
        detail::require_eye_array("latent", host_->latent, ConditionedFeatures::latent_size,
                                  points.position.cols());
        codes_.reserve(queue, std::size_t(2 * code));
    }
    template <class Of>
    void set(const CudaQueue& queue, const Of& of, const DeviceEyeFrame& frame) {
        encode(queue, frame);
        for (int eye = 0; eye < 2; ++eye)
            color_[eye]->set(queue, device_parameters(host_->color, of),
                             codes_.data() + eye * code);
    }
    template <class Of>
    void set_frame(const CudaQueue& queue, const Of&, const DeviceEyeFrame& frame) {
        encode(queue, frame);
        for (int eye = 0; eye < 2; ++eye) color_[eye]->set_frame(queue, codes_.data() + eye * code);
    }
    template <class Of>
    void features_into(const CudaQueue& queue, const Of& of, const DeviceEyeFrame&,
                       const DeviceColumns<float>& feature, bool keep) {
        for (int eye = 0; eye < 2; ++eye)
            color_[eye]->forward_into(queue, detail::columns_of_eye(of(host_->latent), eye, left_),
                                      detail::columns_of_eye(feature, eye, left_), keep);
    }
    template <class Of, class To>
    void vjp_into(const CudaQueue& queue, const Of&, const To& to, const DeviceEyeFrame&,
                  const DeviceColumns<float>& g) {
        for (int eye = 0; eye < 2; ++eye)
            color_[eye]->vjp_into(
                queue, detail::columns_of_eye(g, eye, left_),
                {device_parameters(host_->color, to),
                 detail::columns_of_eye(to(host_->latent), eye, left_), nullptr, true});
    }
    std::size_t bytes() const { return color_[0]->bytes() + color_[1]->bytes() + codes_.bytes(); }

  private:
    static constexpr int code = ConditionedFeatures::gaze_code;
    void encode(const CudaQueue& queue, const DeviceEyeFrame& frame) {
        launch_each(device_, queue, 4, detail::EncodeGazeAngle{frame.gazes, codes_.data(), code});
    }

    Device device_;
    const Parameters* host_;
    std::unique_ptr<Network> color_[2]; ///< the same parameters with the code of each eye's gaze
    Index left_ = 0;
    DeviceBuffer<float> codes_;
};

/// RotatedCode.
template <class Device, class Networks>
class DeviceEyeAppearance<RotatedCode, Device, Networks> {
    using Network = DeviceMlp<Device, typename Networks::OfFeatures>;

  public:
    using Parameters = RotatedCode::Parameters<float>;
    DeviceEyeAppearance(const Device& device, const Parameters& host, DeviceMlpScratch& scratch)
        : device_(device),
          host_(&host) {
        for (auto& n : decoder_) {
            n = std::make_unique<Network>(device, host.decoder.shape);
            n->share(scratch);
        }
    }

    void set_fixed(const CudaQueue& queue, const EyeballPoints& points) {
        left_ = points.left;
        points_ = points.position.cols();
        detail::require_eye_array("latent", host_->latent, rows, 2);
        const VecX<float> none;
        const Columns<float> no_gaze;
        const EyeInputs<float> in{points.position, left_, none, no_gaze, none};
        Columns<float> places(RotatedCode::place_code, points_);
        for (int eye = 0; eye < 2; ++eye)
            places.middleCols(points.first(eye), points.count(eye)) = RotatedCode::places(in, eye);
        places_.reserve(queue, static_cast<std::size_t>(places.size()) + 1);
        device_.send(queue, places_.data(), places.data(),
                     static_cast<std::size_t>(places.size()) * sizeof(float));
        codes_.reserve(queue, std::size_t(4 * rows));
    }
    template <class Of>
    void set(const CudaQueue& queue, const Of& of, const DeviceEyeFrame& frame) {
        turn_codes(queue, of, frame);
        for (int eye = 0; eye < 2; ++eye)
            decoder_[eye]->set(queue, device_parameters(host_->decoder, of), code(eye));
    }
    template <class Of>
    void set_frame(const CudaQueue& queue, const Of& of, const DeviceEyeFrame& frame) {
        turn_codes(queue, of, frame);
        for (int eye = 0; eye < 2; ++eye) decoder_[eye]->set_frame(queue, code(eye));
    }
    template <class Of>
    void features_into(const CudaQueue& queue, const Of&, const DeviceEyeFrame&,
                       const DeviceColumns<float>& feature, bool keep) {
        const DeviceColumns<float> places{places_.data(), RotatedCode::place_code, points_};
        for (int eye = 0; eye < 2; ++eye)
            decoder_[eye]->forward_into(queue, detail::columns_of_eye(places, eye, left_),
                                        detail::columns_of_eye(feature, eye, left_), keep);
    }
    template <class Of, class To>
    void vjp_into(const CudaQueue& queue, const Of&, const To& to, const DeviceEyeFrame& frame,
                  const DeviceColumns<float>& g) {
        for (int eye = 0; eye < 2; ++eye)
            decoder_[eye]->vjp_into(queue, detail::columns_of_eye(g, eye, left_),
                                    {device_parameters(host_->decoder, to), {}, code(2 + eye)});
        launch_each(device_, queue, 2 * rows / 3,
                    detail::TurnTripletVjp{turn(code(2), to(host_->latent).data, frame)});
    }
    std::size_t bytes() const {
        return decoder_[0]->bytes() + decoder_[1]->bytes() + places_.bytes() + codes_.bytes();
    }

  private:
    static constexpr Index rows = RotatedCode::latent_size;
    /// Returns the code of eye k; from k = 2 on its cotangent.
    float* code(int k) const { return codes_.data() + k * rows; }
    detail::TurnTriplet turn(const float* from, float* to, const DeviceEyeFrame& frame) const {
        return {from, to, static_cast<std::uint32_t>(rows / 3), 1U, frame.gazes};
    }
    template <class Of>
    void turn_codes(const CudaQueue& queue, const Of& of, const DeviceEyeFrame& frame) {
        launch_each(device_, queue, 2 * rows / 3, turn(of(host_->latent).data, code(0), frame));
    }

    Device device_;
    const Parameters* host_;
    std::unique_ptr<Network> decoder_[2]; ///< the same parameters with the code of each eye
    Index left_ = 0, points_ = 0;
    DeviceBuffer<float> places_, codes_;
};

} // namespace rye
