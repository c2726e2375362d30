// SPDX-License-Identifier: Apache-2.0
/// device/engine_of.hpp: DeviceEngine by rye::DeviceAvatarTrainer, on any device that runs
/// its kernels: CUDA (engine.hpp), or the emulation of the tests.
#pragma once

#include <rye/avatar/hold.hpp>
#include <rye/loss/cuda/lpips.hpp>
#include <rye/train/cuda/avatar_trainer.hpp>

#include "device/device.hpp"
#include "device/parts.hpp"
#include "device/rank_watch.hpp"

namespace rye::trainer {

/// LPIPS if its weights are given, else the loss without weights. N: planes of its products.
template <class Device, int N>
class ChosenDevicePerceptual {
  public:
    ChosenDevicePerceptual(const CudaQueue& queue,
                           const std::optional<LpipsWeights<float>>& weights)
        : pyramid_(Device{}) {
        if (weights) lpips_ = std::make_unique<DeviceLpips<Device, N>>(Device{}, queue, *weights);
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
    DevicePyramidLoss<Device> pyramid_;
    std::unique_ptr<DeviceLpips<Device, N>> lpips_;
};

/// DeviceEngine on a Machine: a Device, its stream() and its memory, which outlive the work, and
/// its Policy<N, narrow> of N planes.
template <EffectSet E, int N, class Machine, bool narrow = false>
class DeviceEngineOf final : public DeviceEngine<E> {
    using Device = typename Machine::Device;
    using Policy = typename Machine::template Policy<N, narrow>;

  public:
    DeviceEngineOf(const TwoStream<float, E>& avatar, const Adam<TwoStream<float, E>>& adam,
                   const DeviceTask& task)
        : queue_{machine_.stream(), arena_of(task, machine_.memory), task.idle},
          training_(task.training),
          perceptual_(queue_, task.lpips) {
        if (task.ranks != nullptr && task.idle) {
            ranks_ = std::make_unique<IdleRanks>(task.ranks->size());
        } else if (task.ranks != nullptr) {
            ranks_ = Machine::join(*task.ranks);
            watch_ = Machine::watch(*task.ranks, *ranks_);
        }
        group_ = {task.share, ranks_.get(), task.by};
        begin(avatar, adam);
        trainer_->make_room(task.listed);
        if (task.on_device)
            trainer_->views().keep_beyond(*task.on_device, arena_of(task, machine_.page_locked));
    }

    Index add(const TrainingView& view, const Drivers<float>& drivers) override {
        return trainer_->add(queue_, view, restricted<E>(drivers));
    }
    DeviceStepsReport run(const std::vector<StepDraw>& draws, bool ask) override {
        return trainer_->run(queue_, draws, ask);
    }
    void fetch(TwoStream<float, E>& avatar, Adam<TwoStream<float, E>>& adam) const override {
        trainer_->fetch(queue_, avatar, adam);
    }
    void restart(const TwoStream<float, E>& avatar,
                 const Adam<TwoStream<float, E>>& adam) override {
        DeviceViews<Device> views(Device{}, trainer_->views().factor());
        views.take(trainer_->views());
        trainer_.reset(); // frees its memory before the next one allocates
        begin(avatar, adam);
        trainer_->views().take(views);
    }
    DeviceStepsMemory memory() const override {
        DeviceStepsMemory held = trainer_->memory();
        held.losses += perceptual_.bytes();
        return held;
    }

  private:
    using Trainer = DeviceAvatarTrainer<E, Device, Policy, ChosenDevicePerceptual<Device, N>>;

    /// Returns a memory of the machine, or none for an idle task.
    template <DeviceMemory M>
    DeviceArena arena_of(const DeviceTask& task, M& memory) {
        return task.idle ? DeviceArena(nowhere_) : DeviceArena(memory);
    }
    void begin(const TwoStream<float, E>& avatar, const Adam<TwoStream<float, E>>& adam) {
        trainer_ = std::make_unique<Trainer>(Device{}, queue_, AvatarAndAdam<E>{avatar, adam},
                                             training_, perceptual_);
        trainer_->share_steps(queue_, group_);
    }

    Machine machine_; // destroyed last: memory is returned on its stream
    IdleMemory nowhere_;
    CudaQueue queue_;
    decltype(DeviceTask::training) training_;
    ChosenDevicePerceptual<Device, N> perceptual_;
    std::unique_ptr<DeviceRanks> ranks_;
    DeviceStepGroup group_;
    std::unique_ptr<Trainer> trainer_;
    std::unique_ptr<RankWatch> watch_; ///< ends before the ranks that it acts on
};

} // namespace rye::trainer
