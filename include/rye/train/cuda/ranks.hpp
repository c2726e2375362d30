// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/ranks.hpp: ranks of a training whose numbers are in device memory, and their sums
/// by train/group.hpp's tree: each rank adds up one part of the numbers, and all parts are
/// gathered, which moves as many bytes as a ring does.
#pragma once

#include <memory>
#include <vector>

#include <rye/backend/cuda/each.hpp>
#include <rye/train/group.hpp>
#include <rye/train/thread_group.hpp>

namespace rye {

/// A rank's end of a group of devices. All work is put on the queue's stream, and every rank calls
/// the same functions in the same order.
class DeviceRanks {
  public:
    virtual ~DeviceRanks() = default;
    virtual int rank() const = 0;
    virtual int size() const = 0;
    /// Sends part q of `from` to rank q, whose part of this rank becomes part q of `to`; a part has
    /// `part` numbers.
    virtual void exchange(const CudaQueue& queue, const float* from, float* to, Index part) = 0;
    /// Makes the parts of all ranks, in their order, the numbers of `all`. `own` may be this rank's
    /// part of `all`.
    virtual void gather(const CudaQueue& queue, const float* own, float* all, Index part) = 0;
    /// Adds up all ranks' n numbers in an order of its own, if it can; else returns false.
    virtual bool reduce(const CudaQueue&, float*, Index) { return false; }
    /// Throws an Error with the reason if another rank has ended. To be called after a wait.
    virtual void check() {}
};

/// Sums over the ranks of a group.
template <class Device>
class DeviceRankSum {
  public:
    explicit DeviceRankSum(const Device& device) : device_(device) {}

    /// Returns the room that sums of n numbers take: whole parts of vectors.
    static Index room(Index n, int ranks) { return part(n, ranks) * ranks; }

    /// Replaces n numbers, which have room(n) behind `x`, by their sums over all ranks.
    void into(const CudaQueue& queue, DeviceRanks& ranks, float* x, Index n, RankSum by) {
        if (ranks.size() == 1) return;
        if (by == RankSum::library && ranks.reduce(queue, x, n)) return;
        const int size = ranks.size();
        const Index p = part(n, size);
        parts_.reserve(queue, static_cast<std::size_t>(p * size));
        ranks.exchange(queue, x, parts_.data(), p);
        const auto of = [&](int r) { return parts_.data() + r * p; };
        tree_sum(size, [&](int to, int from) {
            launch_each(device_, queue, p, AddNumbers{of(from), of(to)});
        });
        ranks.gather(queue, of(0), x, p);
    }
    std::size_t bytes() const { return parts_.bytes(); }

  private:
    static Index part(Index n, int ranks) {
        constexpr Index whole = 4;
        return (n + whole * ranks - 1) / (whole * ranks) * whole;
    }

    Device device_;
    DeviceBuffer<float> parts_;
};

/// Rank of a group of so many whose queues are idle: its sums take their memory, and nobody adds.
class IdleRanks final : public DeviceRanks {
  public:
    explicit IdleRanks(int size) : size_(size) {}
    int rank() const override { return 0; }
    int size() const override { return size_; }
    void exchange(const CudaQueue&, const float*, float*, Index) override {}
    void gather(const CudaQueue&, const float*, float*, Index) override {}

  private:
    int size_;
};

/// Ranks in threads whose devices' memory is the host's (backend/cuda/emulation.hpp).
class ThreadRanks final : public DeviceRanks {
  public:
    explicit ThreadRanks(const ThreadGroup& group) : group_(group) {}
    int rank() const override { return group_.rank(); }
    int size() const override { return group_.size(); }
    void exchange(const CudaQueue&, const float* from, float* to, Index part) override {
        group_.each_shown(from, [&](int r, const float* theirs) {
            std::copy_n(theirs + rank() * part, part, to + r * part);
        });
    }
    void gather(const CudaQueue&, const float* own, float* all, Index part) override {
        group_.each_shown(own, [&](int r, const float* theirs) {
            if (theirs != all + r * part) std::copy_n(theirs, part, all + r * part);
        });
    }
    void check() override { group_.meet(); }

  private:
    ThreadGroup group_;
};

} // namespace rye
