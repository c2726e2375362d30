// SPDX-License-Identifier: Apache-2.0
/// rye/train/cuda/nccl_ranks.hpp: ranks on devices of NVIDIA, one a device, joined by NCCL, which
/// is loaded when it is asked for: programs need it neither to be built nor to start. Copies and
/// sends only, so that the order of sums is ours; reduce() is NCCL's own sum. NCCL's sums in
/// switches (NVLS) gave bits that depend on what ran before (NVIDIA/nccl issue 2360): set
/// NCCL_NVLS_ENABLE=0 where reduce() is to repeat itself.
/// Source: NVIDIA, "NCCL API", 2.2x: functions, and the values of their enumerations.
#pragma once

#if !defined(_WIN32)

#include <dlfcn.h>

#include <chrono>
#include <cstddef>
#include <exception>
#include <mutex>
#include <string>
#include <type_traits>

#include <rye/train/cuda/ranks.hpp>

namespace rye {

/// What joins the ranks of a group: rank 0 makes it, all of them have a copy.
struct NcclId {
    char bytes[128] = {};
};

/// NCCL's functions.
class NcclLibrary {
  public:
    using Comm = void*;

    /// Loads libnccl.so.2. Throws an Error that says how to get it.
    NcclLibrary() {
        constexpr const char* file = "libnccl.so.2";
        void* const library = dlopen(file, RTLD_NOW | RTLD_LOCAL); // stays for the program's life
        if (library == nullptr) {
            const char* const why = dlerror();
            throw Error(std::string(file) + ": cannot be loaded: " + (why != nullptr ? why : "?") +
                        "; several ranks on devices need NCCL (NVIDIA's package libnccl2, or that "
                        "of PyTorch), in a folder of LD_LIBRARY_PATH");
        }
        const auto find = [&](auto& function, const char* name) {
            void* const p = dlsym(library, name);
            require(p != nullptr, file, "has no function ", name);
            function = reinterpret_cast<std::remove_reference_t<decltype(function)>>(p);
        };
        find(get_unique_id, "ncclGetUniqueId");
        find(init_rank, "ncclCommInitRank");
        find(destroy, "ncclCommDestroy");
        find(abort, "ncclCommAbort");
        find(async_error, "ncclCommGetAsyncError");
        find(error_string, "ncclGetErrorString");
        find(group_start, "ncclGroupStart");
        find(group_end, "ncclGroupEnd");
        find(send, "ncclSend");
        find(recv, "ncclRecv");
        find(all_gather, "ncclAllGather");
        find(all_reduce, "ncclAllReduce");
    }
    /// Throws an Error unless a call succeeded.
    void check(int got, const char* who) const {
        require(got == 0, "NCCL", who, ": got ", got, " (", [&] { return error_string(got); },
                "), expected 0");
    }

    static constexpr int in_progress = 7, float32 = 7, sum = 0;
    int (*get_unique_id)(NcclId*) = nullptr;
    int (*init_rank)(Comm*, int, NcclId, int) = nullptr;
    int (*destroy)(Comm) = nullptr;
    int (*abort)(Comm) = nullptr;
    int (*async_error)(Comm, int*) = nullptr;
    const char* (*error_string)(int) = nullptr;
    int (*group_start)() = nullptr;
    int (*group_end)() = nullptr;
    int (*send)(const void*, std::size_t, int, int, Comm, CudaStream) = nullptr;
    int (*recv)(void*, std::size_t, int, int, Comm, CudaStream) = nullptr;
    int (*all_gather)(const void*, void*, std::size_t, int, Comm, CudaStream) = nullptr;
    int (*all_reduce)(const void*, void*, std::size_t, int, int, Comm, CudaStream) = nullptr;
};

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
        if (std::uncaught_exceptions() > 0) nccl_.abort(comm_);
        else nccl_.destroy(comm_);
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

#endif
