// SPDX-License-Identifier: Apache-2.0
/// device/engine.hpp: DeviceEngineOf and DeviceDrawerOf for CUDA. Under nvcc only; each
/// number of planes and list of effects is a source of its own (device_*.cu), as each takes nvcc a
/// minute. Drawers are in those of drawing_planes, whose kernels they share.
#pragma once

#include <rye/backend/cuda/device.hpp>
#include <rye/backend/cuda/page_locked.hpp>
#include <rye/train/cuda/nccl_ranks.hpp>

#include "device/drawer_of.hpp"
#include "device/engine_of.hpp"

namespace rye::trainer {

/// Current device, with a stream of its own and CUDA's pool of memory.
class CudaMachine {
  public:
    using Device = CudaDevice;
    /// The tiles of choice.hpp: narrow ones take a third off the networks' time.
    template <int N, bool narrow = false>
    using Policy = DeviceTrainerPolicy<
        std::conditional_t<narrow, DeviceNetworks<N, 128, 64, 32>, DeviceNetworks<N>>,
        KernelChannels<3, 16, 32>, Balanced, N>;
    StreamMemory memory;
    PageLockedMemory page_locked;

    CudaMachine() { check_cuda(cudaStreamCreate(&stream_), "cudaStreamCreate"); }
    CudaMachine(const CudaMachine&) = delete;
    CudaMachine& operator=(const CudaMachine&) = delete;
    ~CudaMachine() { static_cast<void>(cudaStreamDestroy(stream_)); }
    CudaStream stream() const { return stream_; }
    /// Returns this device's end of the group; waits for all ranks. NCCL waits for ever for ranks
    /// that it does not find: the program ends after two minutes.
    static std::unique_ptr<DeviceRanks> join(Ranks& ranks) {
        const RankWatch watch(
            ranks, [](const std::string&) {},
            {std::chrono::minutes(2),
             "NCCL has not joined the ranks for 120 s; NCCL_DEBUG=INFO in the environment tells "
             "what it waits for"});
        NcclId id;
        if (ranks.rank() == 0) id = NcclRanks::new_id();
        const std::string words = ranks.given(std::string(id.bytes, sizeof id.bytes));
        require(words.size() == sizeof id.bytes, "CudaMachine", "got an id of ", words.size(),
                " bytes, expected ", sizeof id.bytes);
        words.copy(id.bytes, sizeof id.bytes);
        return std::make_unique<NcclRanks>(id, ranks.rank(), ranks.size());
    }
    /// Returns a watch that ends this device's waits if another rank ends.
    static std::unique_ptr<RankWatch> watch(Ranks& ranks, DeviceRanks& joined) {
        return std::make_unique<RankWatch>(ranks, [&joined](const std::string& reason) {
            static_cast<NcclRanks&>(joined).end(reason);
        });
    }

  private:
    CudaStream stream_ = nullptr;
};

} // namespace rye::trainer
