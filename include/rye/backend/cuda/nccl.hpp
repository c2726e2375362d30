// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/nccl.hpp: NVIDIA's library of communication between devices, which is loaded
/// when it is asked for: programs need it neither to be built nor to start.
/// Source: NVIDIA, "NCCL API", 2.2x: functions, and the values of their enumerations.
#pragma once

#include <cstddef>
#include <string>
#include <type_traits>

#include <rye/backend/cuda.hpp>

#if !defined(_WIN32)
#include <dlfcn.h>
#endif

namespace rye {

/// The name of a group of ranks: rank 0 makes it, all of them have a copy.
struct NcclId {
    char bytes[128] = {};
};

/// NCCL's functions.
class NcclLibrary {
  public:
    using Comm = void*;

    /// Loads libnccl.so.2. Throws an Error that says how to get it.
    NcclLibrary() {
#if defined(_WIN32)
        throw Error("NCCL: there is none for Windows");
#else
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
#endif
    }
    /// Throws an Error unless a call succeeded.
    void check(int got, const char* who) const {
        require(
            got == 0, "NCCL", who, ": got ", got, " (", [&] { return error_string(got); },
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

} // namespace rye
