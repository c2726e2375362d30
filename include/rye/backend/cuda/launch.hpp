// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/launch.hpp: launches of kernels, some of which wait on the device for what is
/// before them on the stream: then their blocks are in place while its last ones run. Only kernels
/// whose predecessor is always one of the same caller's do, so that in a graph with branches they
/// have that one alone. Under nvcc only.
/// Source: NVIDIA, "CUDA Programming Guide", programmatic dependent launch.
#pragma once

#if defined(__CUDACC__)

#include <cuda_runtime.h>

#include <cstddef>

#include <rye/backend/cuda/runtime.hpp>

namespace rye::detail {

/// True if a kernel waits on the device; the kernel says so.
template <class Kernel>
inline constexpr bool waits_on_device = [] {
    if constexpr (requires { Kernel::waits_on_device; })
        return Kernel::waits_on_device;
    else
        return false;
}();
/// True if the next kernel's blocks may take places that this kernel's leave; the kernel says so.
template <class Kernel>
inline constexpr bool admits_next = [] {
    if constexpr (requires { Kernel::admits_next; })
        return Kernel::admits_next;
    else
        return false;
}();

/// Lets the next kernel begin, and waits for the one before, all of whose writes are seen then.
template <class Kernel>
__device__ void meet_neighbours() {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
    if constexpr (admits_next<Kernel>) asm volatile("griddepcontrol.launch_dependents;");
    if constexpr (waits_on_device<Kernel>) asm volatile("griddepcontrol.wait;" ::: "memory");
#endif
}

/// Puts a kernel on the stream. Code for architectures before sm_90 does not wait, so it is not
/// launched early.
template <class Kernel, class Run>
void start(Run run, const Kernel& kernel, unsigned blocks, cudaStream_t stream) {
    constexpr std::size_t bytes = sizeof(typename Kernel::Shared);
    if constexpr (bytes > std::size_t(48) << 10U)
        check_cuda(cudaFuncSetAttribute(run, cudaFuncAttributeMaxDynamicSharedMemorySize,
                                        static_cast<int>(bytes)),
                   Kernel::name);
    if constexpr (waits_on_device<Kernel>) {
        cudaFuncAttributes code{};
        check_cuda(cudaFuncGetAttributes(&code, run), Kernel::name);
        cudaLaunchAttribute early{};
        early.id = cudaLaunchAttributeProgrammaticStreamSerialization;
        early.val.programmaticStreamSerializationAllowed = 1;
        cudaLaunchConfig_t how{};
        how.gridDim = dim3(blocks);
        how.blockDim = dim3(Kernel::threads);
        how.dynamicSmemBytes = bytes;
        how.stream = stream;
        how.attrs = &early;
        how.numAttrs = code.ptxVersion >= 90 ? 1 : 0;
        check_cuda(cudaLaunchKernelEx(&how, run, kernel), Kernel::name);
    } else {
        run<<<blocks, Kernel::threads, bytes, stream>>>(kernel);
        check_cuda(cudaPeekAtLastError(), Kernel::name);
    }
}

} // namespace rye::detail

#endif
