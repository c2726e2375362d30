// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/driven_features.hpp: the eye appearance of rig/driven_features.hpp in device
/// memory: constants plus the outputs of each eye's network over its points; with the cotangents of
/// optical axes and head pose.
#pragma once

#include <memory>

#include <rye/avatar/cuda/eye_parts.hpp>
#include <rye/rig/driven_features.hpp>

namespace rye {

namespace detail {

/// Codes of the turned direction of point i, the second half of its inputs.
struct DrivenPointInputs {
    static constexpr const char* name = "turned directions";
    static constexpr int rows = static_cast<int>(DrivenFeatures::point_inputs()), half = rows / 2;
    const float* direction; ///< at rest, 3 x P
    Index left;             ///< of the left eye
    DeviceGazes gazes;
    float* inputs; ///< rows x P

    RYE_DEVICE void operator()(Index i) const {
        const Vec3<float> turned =
            DrivenFeatures::turn_of(gazes.unit(i < left ? 0 : 1)) * column3(direction, i);
        for (int k = 0; k < 3; ++k)
            encode_number(turned[k], DrivenFeatures::frequencies, 3, inputs + i * rows + half + k);
    }
};

/// Sums over the points of an eye: the cotangent of its turn's matrix, row by row.
struct DrivenTurnVjp {
    static constexpr const char* name = "turned directions, reverse";
    static constexpr int sums = 9;
    const float *direction, *inputs, *g; ///< of the eye's first point on; g: of the inputs

    template <class Sums>
    RYE_DEVICE void operator()(Index i, Sums& sum) const {
        const Vec3<float> d = column3(direction, i);
        const Index at = i * DrivenPointInputs::rows + DrivenPointInputs::half;
        for (int a = 0; a < 3; ++a) {
            const float g_turned =
                encode_number_vjp(inputs + at + a, g + at + a, DrivenFeatures::frequencies, 3);
            for (int b = 0; b < 3; ++b) sum[std::size_t(3 * a + b)] += g_turned * d[b];
        }
    }
};

/// Inputs of a frame that all points of an eye share: the unit gaze, the head's axis-angle where it
/// is read, the expression.
struct DrivenFrameInputs {
    static constexpr const char* name = "frame of driven features";
    DeviceGazes gazes;
    const float* expression;
    int pose, count; ///< 3 or 0; of all of an eye
    float* inputs;   ///< count x 2

    RYE_DEVICE void operator()(Index i) const {
        const int eye = static_cast<int>(i) / count, k = static_cast<int>(i) % count;
        if (k < 3)
            inputs[i] = gazes.unit(eye)[k];
        else if (k < 3 + pose)
            inputs[i] = gazes.frame->pose[k - 3];
        else
            inputs[i] = expression[k - 3 - pose];
    }
};

/// Adds the cotangents of the optical axes, and of the head's axis-angle by both eyes.
struct DrivenFrameVjpKernel {
    static constexpr const char* name = "frame of driven features, reverse";
    static constexpr int threads = 32, blocks = 1;
    struct Shared {};
    DrivenFrameInputs frame;
    const float* g;    ///< of those inputs
    const float* turn; ///< sums of DrivenTurnVjp, 9 x 2
    float* g_axis;     ///< 3 x 2, added to, or null
    float* g_pose;     ///< added to, or null

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            if (t < 2 && g_axis != nullptr && frame.gazes.turns[t]) axis(t);
            if (t == 2 && g_pose != nullptr)
                for (int k = 0; k < frame.pose; ++k) g_pose[k] += g[3 + k] + g[frame.count + 3 + k];
        });
    }

  private:
    RYE_DEVICE void axis(int eye) const {
        Mat3<float> g_turn;
        for (int k = 0; k < 9; ++k) g_turn(k / 3, k % 3) = turn[9 * eye + k];
        add_column<3>(DrivenFeatures::gaze_vjp<float>(frame.gazes.frame->optical[eye], g_turn,
                                                      column3(g + eye * frame.count, 0)),
                      g_axis, eye);
    }
};

} // namespace detail

/// DrivenFeatures.
template <class Device, class Networks>
class DeviceEyeAppearance<DrivenFeatures, Device, Networks> {
    using Network = DeviceMlp<Device, typename Networks::OfFeatures>;

  public:
    using Parameters = DrivenFeatures::Parameters<float>;
    DeviceEyeAppearance(const Device& device, const Parameters& host, DeviceMlpScratch& scratch)
        : device_(device),
          host_(&host),
          sums_(device) {
        for (std::size_t eye = 0; eye < 2; ++eye) {
            if (host.networks[eye].weight.empty()) continue;
            network_[eye] = std::make_unique<Network>(device, host.networks[eye].shape);
            network_[eye]->share(scratch);
        }
    }

    void set_fixed(const CudaQueue& queue, const EyeballPoints& points) {
        left_ = points.left;
        points_ = points.position.cols();
        if (!any()) return;
        const MlpShape& shape = (network_[0] ? network_[0] : network_[1])->shape();
        frame_inputs_ = shape.frame_inputs;
        const Columns<float> d = DrivenFeatures::directions<float>(points.position);
        Columns<float> inputs = Columns<float>::Zero(rows, points_);
        inputs.topRows(rows / 2) = positional_encoding(d, DrivenFeatures::frequencies);
        const auto send = [&](DeviceBuffer<float>& to, const Columns<float>& a) {
            to.reserve(queue, static_cast<std::size_t>(a.size()) + 1);
            device_.send(queue, to.data(), a.data(),
                         static_cast<std::size_t>(a.size()) * sizeof(float));
        };
        send(direction_, d);
        send(inputs_, inputs);
        output_.reserve(queue, static_cast<std::size_t>(shape.outputs() * points_) + 1);
        frame_.reserve(queue, static_cast<std::size_t>(4 * frame_inputs_) + 18);
        device_.fill(queue, frame_.data(), 0, frame_.bytes());
    }
    template <class Of>
    void set(const CudaQueue& queue, const Of& of, const DeviceEyeFrame& frame) {
        if (!any()) return;
        encode(queue, frame);
        each([&](std::size_t eye) {
            network_[eye]->set(queue, device_parameters(host_->networks[eye], of), inputs_of(eye));
        });
    }
    template <class Of>
    void set_frame(const CudaQueue& queue, const Of&, const DeviceEyeFrame& frame) {
        if (!any()) return;
        encode(queue, frame);
        each([&](std::size_t eye) { network_[eye]->set_frame(queue, inputs_of(eye)); });
    }
    template <class Of>
    void features_into(const CudaQueue& queue, const Of& of, const DeviceEyeFrame&,
                       const DeviceColumns<float>& feature, bool keep) {
        launch_each(device_, queue, feature.size(),
                    detail::CopyNumbers{of(host_->feature).data, feature.data});
        each([&](std::size_t eye) {
            const int e = static_cast<int>(eye);
            const DeviceColumns<float> out = detail::columns_of_eye<float>(
                {output_.data(), feature.rows, feature.cols}, e, left_);
            network_[eye]->forward_into(
                queue,
                detail::columns_of_eye<const float>({inputs_.data(), rows, points_}, e, left_), out,
                keep);
            launch_each(
                device_, queue, out.size(),
                detail::AddNumbers{out.data, detail::columns_of_eye(feature, e, left_).data});
        });
    }
    template <class Of, class To>
    void vjp_into(const CudaQueue& queue, const Of&, const To& to, const DeviceEyeFrame& frame,
                  const DeviceColumns<float>& g) {
        launch_each(device_, queue, g.size(), detail::AddNumbers{g.data, to(host_->feature).data});
        if (!any()) return;
        const bool axes = frame.g_axis != nullptr;
        if (axes) g_inputs_.reserve(queue, static_cast<std::size_t>(rows * points_) + 1);
        float* const turn = frame_.data() + 4 * frame_inputs_;
        each([&](std::size_t eye) {
            const int e = static_cast<int>(eye);
            const DeviceColumns<float> g_own =
                detail::columns_of_eye<float>({g_inputs_.data(), rows, points_}, e, left_);
            network_[eye]->vjp_into(queue, detail::columns_of_eye(g, e, left_),
                                    {device_parameters(host_->networks[eye], to),
                                     axes ? g_own : DeviceColumns<float>{}, inputs_of(eye + 2)});
            const Index first = eye == 0 ? 0 : left_;
            if (axes)
                sums_.launch(queue, g_own.cols,
                             detail::DrivenTurnVjp{direction_.data() + 3 * first,
                                                   inputs_.data() + rows * first, g_own.data},
                             {turn + 9 * eye});
        });
        if (axes || frame.g_pose != nullptr)
            device_.launch(queue, 1,
                           detail::DrivenFrameVjpKernel{frame_of(frame), inputs_of(2), turn,
                                                        frame.g_axis, frame.g_pose});
    }
    std::size_t bytes() const {
        std::size_t sum = direction_.bytes() + inputs_.bytes() + g_inputs_.bytes() +
                          output_.bytes() + frame_.bytes() + sums_.bytes();
        each([&](std::size_t eye) { sum += network_[eye]->bytes(); });
        return sum;
    }

  private:
    static constexpr Index rows = DrivenFeatures::point_inputs();
    bool any() const { return network_[0] || network_[1]; }
    template <class F>
    void each(const F& f) const {
        for (std::size_t eye = 0; eye < 2; ++eye)
            if (network_[eye]) f(eye);
    }
    /// Returns the frame's inputs for eye k; from k = 2 on their cotangents, 0 for an eye without a
    /// network.
    float* inputs_of(std::size_t k) const {
        return frame_.data() + k * static_cast<std::size_t>(frame_inputs_);
    }
    detail::DrivenFrameInputs frame_of(const DeviceEyeFrame& frame) const {
        return {frame.gazes, frame.expression, frame.reads_pose ? 3 : 0, frame_inputs_,
                inputs_of(0)};
    }
    void encode(const CudaQueue& queue, const DeviceEyeFrame& frame) {
        launch_each(device_, queue, 2 * frame_inputs_, frame_of(frame));
        launch_each(
            device_, queue, points_,
            detail::DrivenPointInputs{direction_.data(), left_, frame.gazes, inputs_.data()});
    }

    Device device_;
    const Parameters* host_;
    DeviceSums<Device> sums_;
    std::unique_ptr<Network> network_[2]; ///< null for an eye of constants
    Index left_ = 0, points_ = 0;
    int frame_inputs_ = 0;
    DeviceBuffer<float> direction_, inputs_, g_inputs_, output_;
    DeviceBuffer<float> frame_; ///< inputs of both eyes, their cotangents, sums of the turns
};

} // namespace rye
