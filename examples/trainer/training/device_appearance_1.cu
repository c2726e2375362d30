// SPDX-License-Identifier: Apache-2.0
// Stage 2 on a device: avatars of AppearanceEffects, networks' products of 1 plane.
#include "training/device_engine.hpp"

namespace rye::trainer {

template <>
std::unique_ptr<DeviceEngine<AppearanceEffects>> device_engine_of<AppearanceEffects, 1>(
    const TwoStream<float, AppearanceEffects>& avatar,
    const Adam<TwoStream<float, AppearanceEffects>>& adam, const DeviceTask& task) {
    return std::make_unique<DeviceEngineOf<AppearanceEffects, 1, CudaMachine>>(avatar, adam, task);
}

} // namespace rye::trainer
