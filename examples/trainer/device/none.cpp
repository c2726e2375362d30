// SPDX-License-Identifier: Apache-2.0
// Functions of device/device.hpp in a build without kernels (RYE_CUDA=OFF).
#include "device/device.hpp"

namespace rye::trainer {
namespace {

const char* const why = "this build has no kernels (configure it with -DRYE_CUDA=ON)";

} // namespace

bool has_device_kernels() { return false; }
DeviceFinding find_device() { return {false, std::nullopt, why}; }
void use_device(int) { throw Error(std::string("use_device: ") + why); }
int device_count() { return 0; }

template <>
std::unique_ptr<DeviceEngine<TrainEffects>> device_engine<TrainEffects>(const Avatar&,
                                                                        const Adam<Avatar>&,
                                                                        const DeviceTask&) {
    throw Error(std::string("device_engine: ") + why);
}
template <>
std::unique_ptr<DeviceEngine<ComparedEffects>> device_engine<ComparedEffects>(
    const ComparedAvatar&, const Adam<ComparedAvatar>&, const DeviceTask&) {
    throw Error(std::string("device_engine: ") + why);
}

template <>
std::unique_ptr<DeviceDrawer> device_drawer<TrainEffects>(
    const TwoStream<float, TrainEffects>&, const AvatarConfig&, const LandmarkRoles&,
    const std::optional<LpipsWeights<float>>&) {
    throw Error(std::string("device_drawer: ") + why);
}
template <>
std::unique_ptr<DeviceDrawer> device_drawer<ComparedEffects>(
    const TwoStream<float, ComparedEffects>&, const AvatarConfig&, const LandmarkRoles&,
    const std::optional<LpipsWeights<float>>&) {
    throw Error(std::string("device_drawer: ") + why);
}
template <>
std::unique_ptr<DeviceLabels> device_labels<TrainEffects>(const Avatar&, const AvatarConfig&,
                                                          const LandmarkRoles&) {
    throw Error(std::string("device_labels: ") + why);
}

} // namespace rye::trainer
