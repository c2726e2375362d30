// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/page_locked.hpp: memory of the host that a device copies from and to at the
/// speed of its bus; copies of other memory pass through such pages of the driver's. Under nvcc.
#pragma once

#if defined(__CUDACC__)

#include <rye/backend/cuda/device.hpp>

namespace rye {

/// Page-locked memory of the host, a DeviceMemory for NetworkOffload's staging. Each allocation
/// takes the driver about a millisecond.
struct PageLockedMemory {
    /// Returns page-locked memory; throws Error with CUDA's reason if there is none.
    void* allocate(std::size_t bytes, CudaStream) {
        void* p = nullptr;
        check_cuda(cudaMallocHost(&p, bytes), "page-locked memory");
        return p;
    }
    void release(void* p, CudaStream) { static_cast<void>(cudaFreeHost(p)); }
};

} // namespace rye

#endif
