// SPDX-License-Identifier: Apache-2.0
// Stage 2 on a device: avatars of ComparedEffects, networks' products of 1 plane.
#include "device/engine.hpp"

namespace rye::trainer {

template <>
std::unique_ptr<DeviceEngine<ComparedEffects>> device_engine_of<ComparedEffects, 1, false>(
    const TwoStream<float, ComparedEffects>& avatar,
    const Adam<TwoStream<float, ComparedEffects>>& adam, const DeviceTask& task) {
    return std::make_unique<DeviceEngineOf<ComparedEffects, 1, CudaMachine>>(avatar, adam, task);
}

} // namespace rye::trainer
