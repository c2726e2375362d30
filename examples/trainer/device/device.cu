// SPDX-License-Identifier: Apache-2.0
// The device of this machine, and selection among the kernels compiled for it.
#include "device/device.hpp"

#include <cuda_runtime.h>

#include <rye/backend/cuda/runtime.hpp>

namespace rye::trainer {

bool has_device_kernels() { return true; }

DeviceFinding find_device() {
    DeviceFinding f;
    f.built = true;
    int count = 0, current = 0;
    std::size_t free = 0, total = 0;
    cudaDeviceProp properties{};
    cudaError_t got = cudaGetDeviceCount(&count);
    if (got == cudaSuccess) got = cudaGetDevice(&current);
    if (got == cudaSuccess) got = cudaGetDeviceProperties(&properties, current);
    if (got == cudaSuccess) got = cudaMemGetInfo(&free, &total);
    if (got != cudaSuccess) {
        static_cast<void>(cudaGetLastError()); // clears the error for later calls
        f.reason = std::string("CUDA finds no device: ") + cudaGetErrorName(got) + " (" +
                   cudaGetErrorString(got) + ")";
        return f;
    }
    f.found = DeviceFacts{properties.name, static_cast<double>(free), static_cast<double>(total)};
    return f;
}

int device_count() {
    int count = 0;
    if (cudaGetDeviceCount(&count) == cudaSuccess) return count;
    static_cast<void>(cudaGetLastError());
    return 0;
}
void use_device(int which) {
    require(which >= 0 && which < device_count(), "use_device", "got device ", which, " of ",
            device_count());
    check_cuda(cudaSetDevice(which), "cudaSetDevice");
}

namespace {

template <EffectSet E>
std::unique_ptr<DeviceEngine<E>> of_planes(const TwoStream<float, E>& avatar,
                                           const Adam<TwoStream<float, E>>& adam,
                                           const DeviceTask& task) {
    require(task.planes == 1 || task.planes == 3, "device_engine",
            "got " + std::to_string(task.planes) + " planes, expected 1 or 3");
    if constexpr (std::is_same_v<E, TrainEffects>)
        if (task.planes == 1 && task.narrow)
            return device_engine_of<E, 1, true>(avatar, adam, task);
    if (task.planes == 1) return device_engine_of<E, 1, false>(avatar, adam, task);
    return device_engine_of<E, 3, false>(avatar, adam, task);
}

} // namespace

template <>
std::unique_ptr<DeviceEngine<TrainEffects>> device_engine<TrainEffects>(const Avatar& avatar,
                                                                        const Adam<Avatar>& adam,
                                                                        const DeviceTask& task) {
    return of_planes<TrainEffects>(avatar, adam, task);
}
template <>
std::unique_ptr<DeviceEngine<ComparedEffects>> device_engine<ComparedEffects>(
    const ComparedAvatar& avatar, const Adam<ComparedAvatar>& adam, const DeviceTask& task) {
    return of_planes<ComparedEffects>(avatar, adam, task);
}

} // namespace rye::trainer
