// SPDX-License-Identifier: Apache-2.0
// Stage 2 on a device: avatars of VisualEffects, networks' products of 3 planes.
#include "training/device_engine.hpp"

namespace rye::trainer {

template <>
std::unique_ptr<DeviceEngine<VisualEffects>> device_engine_of<VisualEffects, 3>(
    const TwoStream<float, VisualEffects>& avatar,
    const Adam<TwoStream<float, VisualEffects>>& adam, const DeviceTask& task) {
    return std::make_unique<DeviceEngineOf<VisualEffects, 3, CudaMachine>>(avatar, adam, task);
}

} // namespace rye::trainer
