// SPDX-License-Identifier: Apache-2.0
// Stage 2 on a device: avatars of TrainEffects, networks' products of 1 plane, narrow tiles.
#include "device/engine.hpp"

namespace rye::trainer {

template <>
std::unique_ptr<DeviceEngine<TrainEffects>> device_engine_of<TrainEffects, 1, true>(
    const TwoStream<float, TrainEffects>& avatar, const Adam<TwoStream<float, TrainEffects>>& adam,
    const DeviceTask& task) {
    return std::make_unique<DeviceEngineOf<TrainEffects, 1, CudaMachine, true>>(avatar, adam, task);
}

} // namespace rye::trainer
