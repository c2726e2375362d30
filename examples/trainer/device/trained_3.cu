// SPDX-License-Identifier: Apache-2.0
// Stage 2, pictures and labels on a device: avatars of TrainEffects, networks' products of 3 planes.
#include "device/engine.hpp"

namespace rye::trainer {

template <>
std::unique_ptr<DeviceEngine<TrainEffects>> device_engine_of<TrainEffects, 3, false>(
    const TwoStream<float, TrainEffects>& avatar, const Adam<TwoStream<float, TrainEffects>>& adam,
    const DeviceTask& task) {
    return std::make_unique<DeviceEngineOf<TrainEffects, 3, CudaMachine>>(avatar, adam, task);
}

template <>
std::unique_ptr<DeviceDrawer> device_drawer<TrainEffects>(
    const TwoStream<float, TrainEffects>& avatar, const AvatarConfig& config,
    const LandmarkRoles& roles, const std::optional<LpipsWeights<float>>& lpips) {
    return std::make_unique<DeviceDrawerOf<TrainEffects, CudaMachine>>(avatar, config, roles,
                                                                       lpips);
}

template <>
std::unique_ptr<DeviceLabels> device_labels<TrainEffects>(const Avatar& avatar,
                                                          const AvatarConfig& config,
                                                          const LandmarkRoles& roles) {
    return std::make_unique<DeviceLabelsOf<CudaMachine>>(avatar, config, roles);
}

} // namespace rye::trainer
