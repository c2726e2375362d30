// SPDX-License-Identifier: Apache-2.0
/// training/device_engine.hpp: DeviceEngine by DeviceAvatarTrainer. Under nvcc only; each number of
/// planes and list of effects is a source of its own (device_*.cu), as each takes nvcc a minute.
#pragma once

#include <rye/avatar/hold.hpp>
#include <rye/backend/cuda/device.hpp>
#include <rye/loss/cuda/lpips.hpp>
#include <rye/train/cuda/avatar_trainer.hpp>

#include "training/device.hpp"

namespace rye::trainer {

/// A stream of one's own.
class OwnStream {
  public:
    OwnStream() { check_cuda(cudaStreamCreate(&stream_), "cudaStreamCreate"); }
    OwnStream(const OwnStream&) = delete;
    OwnStream& operator=(const OwnStream&) = delete;
    ~OwnStream() { static_cast<void>(cudaStreamDestroy(stream_)); }
    CudaStream get() const { return stream_; }

  private:
    CudaStream stream_ = nullptr;
};

/// LPIPS where its weights are given, else the loss without weights. N: planes of its products.
template <int N>
class ChosenDevicePerceptual {
  public:
    ChosenDevicePerceptual(const CudaQueue& queue,
                           const std::optional<LpipsWeights<float>>& weights)
        : pyramid_(CudaDevice{}) {
        if (weights)
            lpips_ = std::make_unique<DeviceLpips<CudaDevice, N>>(CudaDevice{}, queue, *weights);
    }

    template <class P>
    DeviceLossTerm into(const CudaQueue& queue, const DevicePicture<const float>& picture,
                        const DevicePicture<const P>& truth, double weight,
                        const DevicePicture<float>& g) {
        if (lpips_ != nullptr) return lpips_->into(queue, picture, truth, weight, g);
        return pyramid_.into(queue, picture, truth, weight, g);
    }
    std::size_t bytes() const {
        return pyramid_.bytes() + (lpips_ != nullptr ? lpips_->bytes() : 0);
    }

  private:
    DevicePyramidLoss<CudaDevice> pyramid_;
    std::unique_ptr<DeviceLpips<CudaDevice, N>> lpips_;
};

template <EffectSet E, int N>
class DeviceEngineOf final : public DeviceEngine<E> {
    using Policy = DeviceTrainerPolicy<DeviceNetworks<N>, KernelChannels<3, 16, 32>, Balanced, N>;

  public:
    DeviceEngineOf(const TwoStream<float, E>& avatar, const Adam<TwoStream<float, E>>& adam,
                   const DeviceTask& task)
        : queue_{stream_.get(), memory_},
          perceptual_(queue_, task.lpips),
          trainer_(CudaDevice{}, queue_, {avatar, adam}, task.training, perceptual_) {}

    Index add(const DeviceView& view) override {
        const TrainingView taken{view.camera, view.frame, view.width,   view.height,
                                 view.rgb,    view.mask,  view.visible, view.eyes};
        return trainer_.add(queue_, taken, restricted<E>(view.drivers));
    }
    DeviceReport run(const std::vector<DeviceDraw>& draws) override {
        std::vector<StepDraw> steps;
        for (const DeviceDraw& d : draws)
            steps.push_back({d.view, d.eyes_high, d.scaled, d.scale, d.blank, d.rate});
        const DeviceStepsReport r = trainer_.run(queue_, steps);
        return {r.losses, r.refused_in_a_row, r.bad_field};
    }
    void fetch(TwoStream<float, E>& avatar, Adam<TwoStream<float, E>>& adam) const override {
        trainer_.fetch(queue_, avatar, adam);
    }
    double bytes() const override {
        return static_cast<double>(trainer_.bytes() + perceptual_.bytes());
    }

  private:
    OwnStream stream_; // goes last: memory is given back on it
    StreamMemory memory_;
    CudaQueue queue_;
    ChosenDevicePerceptual<N> perceptual_;
    DeviceAvatarTrainer<E, CudaDevice, Policy, ChosenDevicePerceptual<N>> trainer_;
};

} // namespace rye::trainer
