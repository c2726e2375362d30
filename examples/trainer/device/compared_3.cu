// SPDX-License-Identifier: Apache-2.0
// Stage 2 and pictures on a device: avatars of ComparedEffects, networks' products of 3 planes.
#include "device/engine.hpp"

namespace rye::trainer {

template <>
std::unique_ptr<DeviceEngine<ComparedEffects>> device_engine_of<ComparedEffects, 3, false>(
    const TwoStream<float, ComparedEffects>& avatar,
    const Adam<TwoStream<float, ComparedEffects>>& adam, const DeviceTask& task) {
    return std::make_unique<DeviceEngineOf<ComparedEffects, 3, CudaMachine>>(avatar, adam, task);
}

template <>
std::unique_ptr<DeviceDrawer> device_drawer<ComparedEffects>(
    const TwoStream<float, ComparedEffects>& avatar, const AvatarConfig& config,
    const LandmarkRoles& roles, const std::optional<LpipsWeights<float>>& lpips) {
    return std::make_unique<DeviceDrawerOf<ComparedEffects, CudaMachine>>(avatar, config, roles,
                                                                          lpips);
}

} // namespace rye::trainer
