// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/nccl_ranks.hpp: ranks on devices of NVIDIA, one a device, joined by NCCL. They
/// use its copies alone, so that the order of sums is ours; reduce() is NCCL's own sum. NCCL's sums
/// in switches (NVLS) gave bits that depend on what ran before (NVIDIA/nccl issue 2360): set
/// NCCL_NVLS_ENABLE=0 where reduce() is to repeat itself.
#pragma once

#include <chrono>
#include <cstddef>
#include <exception>
#include <mutex>
#include <string>

#include <rye/backend/cuda/nccl.hpp>
#include <rye/train/cuda/ranks.hpp>

namespace rye {

/// A rank's end of a group, on the device that is current when it is made.
class NcclRanks final : public DeviceRanks {
  public:
    /// Returns a new group's id.
    static NcclId new_id() {
        const NcclLibrary nccl;
        NcclId id;
        nccl.check(nccl.get_unique_id(&id), "ncclGetUniqueId");
        return id;
    }
    /// Waits until all ranks are there. Throws an Error if NCCL fails.
    NcclRanks(const NcclId& id, int rank, int size) : rank_(rank), size_(size) {
        nccl_.check(nccl_.init_rank(&comm_, size, id, rank), "ncclCommInitRank");
    }
    NcclRanks(const NcclRanks&) = delete;
    NcclRanks& operator=(const NcclRanks&) = delete;
    ~NcclRanks() override {
        const std::lock_guard<std::mutex> lock(state_);
        if (comm_ == nullptr) return;
        // Others may never come where this rank ends by an exception.
        if (std::uncaught_exceptions() > 0)
            nccl_.abort(comm_);
        else
            nccl_.destroy(comm_);
    }

    int rank() const override { return rank_; }
    int size() const override { return size_; }
    void exchange(const CudaQueue& queue, const float* from, float* to, Index part) override {
        const auto n = static_cast<std::size_t>(part);
        use([&](NcclLibrary::Comm comm) {
            nccl_.check(nccl_.group_start(), "ncclGroupStart");
            for (int r = 0; r < size_; ++r) {
                nccl_.check(nccl_.send(from + r * part, n, nccl_.float32, r, comm, queue.stream),
                            "ncclSend");
                nccl_.check(nccl_.recv(to + r * part, n, nccl_.float32, r, comm, queue.stream),
                            "ncclRecv");
            }
            nccl_.check(nccl_.group_end(), "ncclGroupEnd");
        });
    }
    void gather(const CudaQueue& queue, const float* own, float* all, Index part) override {
        use([&](NcclLibrary::Comm comm) {
            nccl_.check(nccl_.all_gather(own, all, static_cast<std::size_t>(part), nccl_.float32,
                                         comm, queue.stream),
                        "ncclAllGather");
        });
    }
    bool reduce(const CudaQueue& queue, float* x, Index n) override {
        use([&](NcclLibrary::Comm comm) {
            nccl_.check(nccl_.all_reduce(x, x, static_cast<std::size_t>(n), nccl_.float32,
                                         nccl_.sum, comm, queue.stream),
                        "ncclAllReduce");
        });
        return true;
    }
    void check() override {
        int error = 0;
        use([&](NcclLibrary::Comm comm) {
            nccl_.check(nccl_.async_error(comm, &error), "ncclCommGetAsyncError");
        });
        if (error != NcclLibrary::in_progress) nccl_.check(error, "a device's work");
    }
    /// Ends the work that waits for other ranks, on any thread: the owner's next call, or check(),
    /// throws an Error with the reason.
    void end(const std::string& reason) {
        // Not longer: the owner may hang in a call that waits for a rank that is gone.
        const std::unique_lock<std::timed_mutex> calls(calls_, std::chrono::seconds(2));
        const std::lock_guard<std::mutex> lock(state_);
        if (!ended_.empty()) return;
        ended_ = reason;
        if (comm_ != nullptr) nccl_.abort(comm_);
        comm_ = nullptr;
    }

  private:
    template <class F>
    void use(const F& f) {
        const std::lock_guard<std::timed_mutex> calls(calls_);
        const auto comm = [&] { // throws the reason, if there is one
            const std::lock_guard<std::mutex> lock(state_);
            if (!ended_.empty()) throw Error(ended_);
            return comm_;
        };
        try {
            f(comm());
        } catch (const Error&) {
            static_cast<void>(comm());
            throw;
        }
    }

    NcclLibrary nccl_;
    int rank_, size_;
    NcclLibrary::Comm comm_ = nullptr;
    std::timed_mutex calls_; ///< held while NCCL is called
    std::mutex state_;       ///< of comm_ and ended_
    std::string ended_;      ///< reason of end()
};

} // namespace rye
