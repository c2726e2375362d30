// SPDX-License-Identifier: Apache-2.0
/// device/choice.hpp: the policy that selects a device or the CPU for stage 2 of `rye
/// train`, and for commands that draw a run.
#pragma once

#include <limits>
#include <string>

#include "data/config.hpp"
#include "device/device.hpp"

namespace rye::trainer {

/// Values of --device.
enum class DeviceWish { automatic, cpu, cuda };

/// Returns the value for a word: auto, cpu or cuda.
inline DeviceWish device_wish(const std::string& word) {
    return word == "auto"  ? DeviceWish::automatic
           : word == "cpu" ? DeviceWish::cpu
                           : DeviceWish::cuda;
}

/// Parameters of rye::DeviceNetworks.
struct KernelTiles {
    int widest, features, codes;
};
inline constexpr KernelTiles wide_tiles{256, 128, 64}, narrow_tiles{128, 64, 32};

/// Returns the field of a configuration that tiles have no room for, as "avatar.feature is 129",
/// with the expected range; empty if all fit.
inline std::string beyond(const TrainConfig& c, const KernelTiles& tiles) {
    const auto [widest, features, codes] = tiles;
    constexpr int layers = 8;
    const AvatarConfig& a = c.avatar;
    const auto over = [](const std::string& field, int got, int most) {
        return got <= most ? ""
                           : field + " is " + std::to_string(got) + ", kernels have room for " +
                                 std::to_string(most);
    };
    std::string words = over("avatar.feature", a.feature, features);
    if (words.empty()) words = over("avatar.frequencies", a.frequencies, (codes / 3 - 1) / 2);
    if (words.empty()) words = over("avatar.channels", a.channels, widest);
    const NetworkConfig& n = a.networks;
    const auto network = [&](const std::string& name, const std::vector<int>& hidden, int most) {
        const std::string field = "avatar.networks." + name;
        if (words.empty())
            words =
                over("number of layers of " + field, static_cast<int>(hidden.size()) + 1, layers);
        for (const int width : hidden)
            if (words.empty()) words = over("a width of " + field, width, most);
    };
    network("exp_color", n.exp_color, widest);
    network("pose_color", n.pose_color, widest);
    network("exp_deform", n.exp_deform, widest);
    network("pose_deform", n.pose_deform, widest);
    network("exp_attributes", n.exp_attributes, widest);
    network("pose_attributes", n.pose_attributes, widest);
    network("gaze_deform", n.gaze_deform, widest);
    network("gaze_color", n.gaze_color, widest);
    network("eye_offset", n.eye_offset, std::numeric_limits<int>::max());
    return words;
}

/// Returns the field of a configuration that has no kernels; empty if a device can train and draw
/// it.
inline std::string without_kernels(const TrainConfig& c) { return beyond(c, wide_tiles); }

/// Decision to train stage 2 or to draw on a device or the CPU.
struct DeviceDecision {
    bool device = false;
    std::string reason; ///< for the CPU, if a build with kernels chose it by itself; else empty
};

/// Returns a device if the build has kernels, a device is present and the configuration has
/// kernels; else the CPU. Throws an Error that begins with --device if `wish` asks for a device in
/// vain.
inline DeviceDecision decided(DeviceWish wish, const TrainConfig& config,
                              const DeviceFinding& finding) {
    if (wish == DeviceWish::cpu) return {};
    const std::string none = finding.found ? without_kernels(config) : finding.reason;
    if (none.empty()) return {true, ""};
    require(wish == DeviceWish::automatic, "--device", "got cuda, but " + none);
    return {false, finding.built ? none : ""};
}

} // namespace rye::trainer
