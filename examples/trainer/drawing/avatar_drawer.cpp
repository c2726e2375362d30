// SPDX-License-Identifier: Apache-2.0
#include "drawing/avatar_drawer.hpp"

#include <mutex>
#include <optional>

#include <rye/io/lpips_weights.hpp>

namespace rye::trainer {

/// A device's drawer and its lock.
struct AvatarDrawer::OnDevice {
    DeviceFacts facts;
    std::unique_ptr<DeviceDrawer> drawer;
    std::mutex mutex;

    Image<float> picture(const TrainState& state, const DrawnFrame& frame) {
        drawer->set_dilation(frame.dilation);
        drawer->drive(all_drivers(frame, frame.camera), frame.camera);
        const int factor = 1 << state.config.gaussians.upsampler.doublings;
        return of_camera(drawer->picture(reduced(frame.camera, factor)), frame.camera);
    }
};

namespace {

/// Returns a drawer of the state's avatar.
std::unique_ptr<DeviceDrawer> drawer_of(const TrainState& state,
                                        const std::optional<LpipsWeights<float>>& lpips) {
    const AvatarConfig& config = state.config.avatar;
    const LandmarkRoles& roles = state.subject.roles;
    if (state.compared)
        return device_drawer<ComparedEffects>(state.compared->avatar, config, roles, lpips);
    return device_drawer<TrainEffects>(state.avatar, config, roles, lpips);
}

} // namespace

AvatarDrawer::AvatarDrawer(const TrainState& state, DeviceWish wish,
                           const std::filesystem::path& perceptual_weights)
    : state_(&state) {
    std::string reason;
    if (wish != DeviceWish::cpu) {
        const DeviceFinding finding = find_device();
        const DeviceDecision decision = decided(wish, state.config, finding);
        reason = decision.reason;
        if (decision.device) {
            std::optional<LpipsWeights<float>> weights;
            if (!perceptual_weights.empty())
                weights = read_lpips_weights<float>(perceptual_weights);
            try {
                auto made = std::make_shared<OnDevice>();
                made->facts = *finding.found;
                made->drawer = drawer_of(state, weights);
                device_ = std::move(made);
            } catch (const Error& e) { // too little memory
                require(wish == DeviceWish::automatic, "--device",
                        std::string("got cuda, but ") + e.what());
                reason = e.what();
            }
        }
    }
    if (device_) {
        words_ = "pictures are drawn on " + device_->facts.name;
        if (!perceptual_weights.empty())
            lpips_ = [device = device_](const Image<float>& a, const Image<float>& b) {
                const std::lock_guard<std::mutex> lock(device->mutex);
                return device->drawer->lpips(a, b);
            };
        return;
    }
    if (!reason.empty()) words_ = "pictures are drawn on the CPU: " + reason;
    lpips_ = lpips_of(perceptual_weights);
}

std::string AvatarDrawer::name() const { return device_ ? device_->facts.name : "cpu"; }

Image<float> AvatarDrawer::picture(const DrawnFrame& frame) const {
    if (!device_) return render_avatar(*state_, frame).high;
    const std::lock_guard<std::mutex> lock(device_->mutex);
    return device_->picture(*state_, frame);
}

ShownAvatar AvatarDrawer::shown(const DrawnFrame& frame) const {
    if (!device_) return shown_avatar(*state_, frame);
    ShownAvatar r;
    r.eyes.centre = posed_centres(*state_, frame.drivers);
    const std::lock_guard<std::mutex> lock(device_->mutex);
    r.picture = device_->picture(*state_, frame);
    r.eyes.area = device_->drawer->eyes(frame.camera);
    return r;
}

} // namespace rye::trainer
