// SPDX-License-Identifier: Apache-2.0
// A device for the program rye where there is none: the kernels of stage 2, and those that draw,
// run on the host. It has as many bytes free as the environment variable RYE_EMULATED_BYTES says,
// and after the first look as RYE_EMULATED_LATER_BYTES says: others may have taken some.
#include <cstdlib>

#include <rye/backend/cuda/emulation.hpp>

#include "device/drawer_of.hpp"
#include "device/engine_of.hpp"

namespace rye::trainer {
namespace {

struct HostMachine {
    using Device = EmulatedDevice;
    /// For the small avatars of tests, with room for networks of the eyes' parts.
    template <int N, bool = false>
    using Policy =
        DeviceTrainerPolicy<DeviceNetworks<N, 128, 64, 32>, KernelChannels<3, 8>, Balanced, N>;
    HostMemory memory, page_locked;

    static CudaStream stream() { return nullptr; }
    static std::unique_ptr<DeviceRanks> join(Ranks& ranks) {
        return std::make_unique<ThreadRanks>(*ranks.threads());
    }
    static std::unique_ptr<RankWatch> watch(Ranks&, DeviceRanks&) { return nullptr; }
};

template <EffectSet E>
std::unique_ptr<DeviceEngine<E>> emulated(const TwoStream<float, E>& avatar,
                                          const Adam<TwoStream<float, E>>& adam,
                                          const DeviceTask& task) {
    require(task.planes == 3, "emulated device",
            "got " + std::to_string(task.planes) + " planes, expected 3");
    return std::make_unique<DeviceEngineOf<E, 3, HostMachine>>(avatar, adam, task);
}

} // namespace

bool has_device_kernels() { return true; }
DeviceFinding find_device() {
    static bool looked = false;
    const char* const bytes =
        std::getenv(looked ? "RYE_EMULATED_LATER_BYTES" : "RYE_EMULATED_BYTES");
    looked = true;
    const double free = bytes != nullptr ? std::strtod(bytes, nullptr) : 1e9;
    return {true, DeviceFacts{"an emulated device", free, 1e9}, ""};
}
void use_device(int) {}
int device_count() { return 64; }

template <>
std::unique_ptr<DeviceEngine<TrainEffects>> device_engine<TrainEffects>(const Avatar& avatar,
                                                                        const Adam<Avatar>& adam,
                                                                        const DeviceTask& task) {
    return emulated<TrainEffects>(avatar, adam, task);
}
template <>
std::unique_ptr<DeviceEngine<ComparedEffects>> device_engine<ComparedEffects>(
    const ComparedAvatar& avatar, const Adam<ComparedAvatar>& adam, const DeviceTask& task) {
    return emulated<ComparedEffects>(avatar, adam, task);
}

template <>
std::unique_ptr<DeviceDrawer> device_drawer<TrainEffects>(
    const TwoStream<float, TrainEffects>& avatar, const AvatarConfig& config,
    const LandmarkRoles& roles, const std::optional<LpipsWeights<float>>& lpips) {
    return std::make_unique<DeviceDrawerOf<TrainEffects, HostMachine>>(avatar, config, roles,
                                                                       lpips);
}
template <>
std::unique_ptr<DeviceDrawer> device_drawer<ComparedEffects>(
    const TwoStream<float, ComparedEffects>& avatar, const AvatarConfig& config,
    const LandmarkRoles& roles, const std::optional<LpipsWeights<float>>& lpips) {
    return std::make_unique<DeviceDrawerOf<ComparedEffects, HostMachine>>(avatar, config, roles,
                                                                          lpips);
}
template <>
std::unique_ptr<DeviceLabels> device_labels<TrainEffects>(const Avatar& avatar,
                                                          const AvatarConfig& config,
                                                          const LandmarkRoles& roles) {
    return std::make_unique<DeviceLabelsOf<HostMachine>>(avatar, config, roles);
}

} // namespace rye::trainer
