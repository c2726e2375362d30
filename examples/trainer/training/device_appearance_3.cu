// SPDX-License-Identifier: Apache-2.0
// Stage 2 and pictures on a device: avatars of AppearanceEffects, networks' products of 3 planes.
#include "training/device_engine.hpp"

namespace rye::trainer {

template <>
std::unique_ptr<DeviceEngine<AppearanceEffects>> device_engine_of<AppearanceEffects, 3>(
    const TwoStream<float, AppearanceEffects>& avatar,
    const Adam<TwoStream<float, AppearanceEffects>>& adam, const DeviceTask& task) {
    return std::make_unique<DeviceEngineOf<AppearanceEffects, 3, CudaMachine>>(avatar, adam, task);
}

template <>
std::unique_ptr<DeviceDrawer> device_drawer<AppearanceEffects>(
    const TwoStream<float, AppearanceEffects>& avatar, const AvatarConfig& config,
    const LandmarkRoles& roles, const std::optional<LpipsWeights<float>>& lpips) {
    return std::make_unique<DeviceDrawerOf<AppearanceEffects, CudaMachine>>(avatar, config, roles,
                                                                            lpips);
}

} // namespace rye::trainer
