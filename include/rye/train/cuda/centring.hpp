// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/centring.hpp: train/centring.hpp in device memory.
#pragma once

#include <rye/avatar/two_stream.hpp>
#include <rye/nn/cuda/adam.hpp>
#include <rye/train/centring.hpp>
#include <rye/train/view_gauge.hpp>

namespace rye::detail {

/// Kernel that subtracts from each row its mean over columns, if the optimiser has applied its
/// step.
struct CentreRowsKernel {
    static constexpr const char* name = "corrections centred";
    static constexpr int threads = 128, blocks = 1, most = 8;
    struct Shared {
        float mean[most];
    };
    const DeviceAdamState* adam;
    DeviceColumns<float> array; ///< at most `most` rows

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        if (adam->bad != 0) return;
        block.each_thread([&](int t) {
            if (t < array.rows)
                shared.mean[t] = mean_of_row<float>(array.data + t, array.rows, array.cols);
        });
        block.each_thread([&](int t) {
            for (Index i = t; i < array.rows * array.cols; i += threads)
                array.data[i] -= shared.mean[i % array.rows];
        });
    }
};

/// Kernel that subtracts from each column of delta_view what all share, if the optimiser has
/// applied its step.
struct CentreViewsKernel {
    static constexpr const char* name = "views centred";
    static constexpr int threads = 128, blocks = 1, most = 16;
    struct Shared {
        float mode[most];
    };
    const DeviceAdamState* adam;
    const float* gauge;         ///< view_gauge()
    Index modes;                ///< of the gauge, at most `most`
    DeviceColumns<float> array; ///< delta_view

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared& shared) const {
        if (adam->bad != 0) return;
        block.each_thread([&](int t) {
            if (t < modes)
                shared.mode[t] = shared_mode(gauge + t * array.size(), array.data, array.size());
        });
        block.each_thread([&](int t) {
            for (Index i = t; i < array.size(); i += threads)
                array.data[i] = without_shared(array.data[i], gauge + modes * array.size() + i,
                                               array.size(), shared.mode, modes);
        });
    }
};

/// Subtracts after a step what corrections share: from those of gazes their mean over frames, from
/// those of poses too if the training says so, and from those of cameras what all show alike.
template <EffectSet E, class Device>
class DeviceCentring {
    using Host = TwoStream<float, E>;

  public:
    /// Waits. Throws an Error unless there is a unit vector for each camera that is corrected.
    template <class Training>
    DeviceCentring(const Device& device, [[maybe_unused]] const CudaQueue& queue,
                   [[maybe_unused]] const Host& host, const Training& training)
        : device_(device), poses_(training.centred_corrections) {
        if constexpr (has_effect<E, HeadPose>)
            if (host.delta_view.size() > 0) {
                check_directions(training.view_directions, host.delta_view.cols(),
                                 "DeviceAvatarTrainer");
                const auto gauge =
                    Columns<float>(view_gauge(training.view_directions).template cast<float>());
                modes_ = gauge.cols() / 2;
                gauge_.reserve(queue, static_cast<std::size_t>(gauge.size()));
                device.send(queue, gauge_.data(), gauge.data(),
                            static_cast<std::size_t>(gauge.size()) * sizeof(float));
            }
    }

    /// Enqueues it. host: shapes of the parameters.
    void into([[maybe_unused]] const CudaQueue& queue,
              [[maybe_unused]] const DeviceAdamState* adam, [[maybe_unused]] const Host& host,
              [[maybe_unused]] const Resident<Host, Device>& parameters) const {
        [[maybe_unused]] const auto centre = [&](const Columns<float>& array) {
            device_.launch(queue, 1, CentreRowsKernel{adam, parameters.of(array)});
        };
        if constexpr (has_effect<E, HeadPose>)
            if (host.delta_view.size() > 0)
                device_.launch(
                    queue, 1,
                    CentreViewsKernel{adam, gauge_.data(), modes_, parameters.of(host.delta_view)});
        if constexpr (has_effect<E, Kappa>)
            if (host.delta_gaze.size() > 0) centre(host.delta_gaze);
        if constexpr (has_effect<E, ReadsHeadPose>)
            if (poses_ && host.delta_pose.size() > 0) centre(host.delta_pose);
    }
    std::size_t bytes() const { return gauge_.bytes(); }

  private:
    Device device_;
    bool poses_;
    DeviceBuffer<float> gauge_; ///< view_gauge()
    Index modes_ = 0;           ///< of gauge_
};

} // namespace rye::detail
