// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/step_sums.hpp: sums over the pictures of a training step on a device, and over
/// the ranks of a group: gradient, losses, and what ranks must agree on before Adam: whether lists
/// had room and whether somebody asks to stop. By the tree of train/group.hpp.
#pragma once

#include <memory>
#include <vector>

#include <rye/train/cuda/ranks.hpp>
#include <rye/train/cuda/step_kernels.hpp>

namespace rye {

namespace detail {

/// Numbers behind a step's gradient: losses, their total, and flags of any rank.
struct StepTail {
    static constexpr Index total = LossReport::most, stop = total + 1, ask = total + 2,
                           size = total + 3;
};

/// Writes a picture's gradient and losses times its share in the step, and counts the picture.
struct PutPicture {
    static constexpr const char* name = "share of a picture";
    const float* gradient;
    Index numbers; ///< of the gradient
    const LossReport* losses;
    DeviceStepState* state;
    float share;
    float* to; ///< numbers + StepTail::size

    RYE_DEVICE void operator()(Index i) const {
        if (i < numbers) {
            to[i] = share * gradient[i];
            return;
        }
        const Index k = i - numbers;
        if (k < StepTail::total)
            to[i] = share * losses->value[k];
        else if (k == StepTail::total)
            to[i] = share * losses->total;
        else if (k == StepTail::stop)
            to[i] = state->control.stop != 0 ? 1.0F : 0.0F;
        else
            to[i] = state->ask != 0 ? 1.0F : 0.0F, ++state->picture;
    }
};

/// Takes over what the tail says of all ranks, and begins to count pictures anew.
struct TakeTail {
    static constexpr const char* name = "sums of a step";
    static constexpr int threads = 32, blocks = 1;
    struct Shared {};
    const float* tail;
    LossReport* losses; ///< means
    DeviceStepState* state;

    template <class Block>
    RYE_DEVICE void operator()(Block& block, Shared&) const {
        block.each_thread([&](int t) {
            if (t < LossReport::most) losses->value[t] = tail[t];
            if (t != 0) return;
            losses->total = tail[StepTail::total];
            if (tail[StepTail::stop] != 0) state->control.stop = 1;
            state->asked = tail[StepTail::ask] != 0 ? 1 : 0;
            state->picture = 0;
        });
    }
};

} // namespace detail

/// How the steps of a trainer are shared: its pictures of each step and, if there are several
/// ranks, its end of their group, which must outlive the trainer.
struct DeviceStepGroup {
    StepShare share = {};
    DeviceRanks* ranks = nullptr; ///< null: one rank
    RankSum by = RankSum::tree;

    /// True if a step is one picture of one rank, for which nothing is summed.
    bool single() const { return share.all == 1 && ranks == nullptr; }
};

namespace detail {

/// Sums of a step.
template <class Device>
class DeviceStepSums {
  public:
    explicit DeviceStepSums(const Device& device) : device_(device), over_ranks_(device) {}

    /// Takes memory for steps of gradients of so many numbers.
    void set(const CudaQueue& queue, const DeviceStepGroup& group, Index numbers) {
        group_ = group;
        numbers_ = numbers;
        levels_ = {};
        level_.clear();
        const Index all = numbers + StepTail::size;
        const int ranks = group.ranks != nullptr ? group.ranks->size() : 1;
        for (int k = 0; k < TreeLevels::levels(group.share.count); ++k) {
            level_.push_back(std::make_unique<DeviceBuffer<float>>());
            level_.back()->reserve(
                queue, static_cast<std::size_t>(DeviceRankSum<Device>::room(all, ranks)));
        }
        mean_.reserve(queue, 1);
    }
    /// Enqueues the sum of a picture's gradient and losses.
    void add_into(const CudaQueue& queue, const float* gradient, const LossReport* losses,
                  DeviceStepState* state) {
        levels_.add(
            [&](int level) {
                launch_each(device_, queue, numbers_ + StepTail::size,
                            PutPicture{gradient, numbers_, losses, state,
                                       1.0F / static_cast<float>(group_.share.all), at(level)});
            },
            [&](int level) { join(queue, level); });
    }
    /// Enqueues the sums over all pictures and ranks; returns the gradient.
    const float* close_into(const CudaQueue& queue, DeviceStepState* state) {
        levels_.close([&](int level) { join(queue, level); });
        if (group_.ranks != nullptr)
            over_ranks_.into(queue, *group_.ranks, at(0), numbers_ + StepTail::size, group_.by);
        device_.launch(queue, 1, TakeTail{at(0) + numbers_, mean_.data(), state});
        return at(0);
    }
    /// Returns the losses of the step, in device memory.
    const LossReport* losses() const { return mean_.data(); }
    std::size_t bytes() const {
        std::size_t sum = over_ranks_.bytes() + mean_.bytes();
        for (const auto& l : level_) sum += l->bytes();
        return sum;
    }

  private:
    float* at(int level) const { return level_[static_cast<std::size_t>(level)]->data(); }
    void join(const CudaQueue& queue, int level) {
        launch_each(device_, queue, numbers_ + StepTail::size,
                    AddNumbers{at(level + 1), at(level)});
    }

    Device device_;
    DeviceStepGroup group_;
    Index numbers_ = 0;
    TreeLevels levels_;
    std::vector<std::unique_ptr<DeviceBuffer<float>>> level_;
    DeviceRankSum<Device> over_ranks_;
    DeviceBuffer<LossReport> mean_;
};

} // namespace detail

} // namespace rye
