// SPDX-License-Identifier: Apache-2.0
// Device memory of an avatar as it is stated before a training, against what the avatar holds on a
// device that takes memory and runs nothing.
#include <doctest/doctest.h>

#include <cstring>

#include <rye/avatar/cuda/two_stream.hpp>
#include <rye/avatar/hold.hpp>
#include <rye/backend/cuda/emulation.hpp>

#include "device/memory.hpp"
#include "tiny_run.hpp"

using namespace rye;
using namespace rye::trainer;

namespace {

struct IdleDevice {
    template <class Kernel>
    void launch(const CudaQueue&, Index, const Kernel&) const {}
    void fill(const CudaQueue&, void*, int, std::size_t) const {}
    void send(const CudaQueue&, void*, const void*, std::size_t) const {}
    void fetch(const CudaQueue&, void* to, const void*, std::size_t bytes) const {
        std::memset(to, 0, bytes);
    }
};

double part(const DeviceNeed& need, const std::string& name) {
    for (const auto& p : need.parts)
        if (p.name == name) return p.bytes;
    FAIL(name);
    return 0;
}

/// An avatar of those sizes.
Avatar avatar_of(const TrainConfig& config, const DeviceSizes& sizes) {
    test::Draw draw;
    Avatar a = restricted<TrainEffects>(
        test::lifted<float>(test::tiny_avatar(config.avatar, draw)));
    const auto face = static_cast<Index>(sizes.face), eyes = static_cast<Index>(sizes.eyes);
    for (Columns<float>* c : {&a.face.position, &a.face.feature, &a.face.log_scale,
                              &a.face.rotation, &a.face.opacity_logit})
        *c = Columns<float>::Zero(c->rows(), face);
    for (Columns<float>* c : {&a.eyes.position, &a.eyes.feature, &a.eyes.log_scale,
                              &a.eyes.rotation, &a.eyes.opacity_logit, &a.eyes.spacing})
        *c = Columns<float>::Zero(c->rows(), eyes);
    a.eyes.left_points = eyes / 2;
    UpsamplerShape shape = config.gaussians.upsampler;
    shape.in_channels = config.avatar.channels;
    a.upsampler = Upsampler<float>::init(shape, Random{5, 0});
    a.delta_pose = Columns<float>::Zero(6, static_cast<Index>(sizes.frames));
    return a;
}

/// The same with driven eyes and shading.
Avatar lit_avatar_of(const TrainConfig& config, const DeviceSizes& sizes) {
    Avatar a = avatar_of(config, sizes);
    const Index face = a.face.position.cols(), eyes = a.eyes.position.cols();
    a.eyes.kappa = Columns<float>::Zero(2, 2);
    a.eyes.appearance() = init_eye_appearance<DrivenFeatures, float>(
        appearance_sizes<TrainEffects>(config.avatar, eyes), Random{6, 0});
    a.shading = {Columns<float>::Zero(8, 3), Columns<float>::Zero(3, face),
                 Columns<float>::Zero(3, 2)};
    return a;
}

template <int N, EffectSet E>
void stated_is_held(TrainConfig config, const DeviceSizes& sizes, const TwoStream<float, E>& host) {
    CAPTURE(N);
    config.gaussians.planes = N;
    HostMemory memory;
    const CudaQueue queue{nullptr, memory};
    DeviceTwoStream<E, IdleDevice, DeviceNetworks<N>> avatar(
        IdleDevice{}, queue, {host, config.avatar, test::tiny_roles()});
    // Room is a quarter more than the points that were found.
    std::vector<std::uint32_t> found;
    for (const double room : sizes.listed)
        found.push_back(static_cast<std::uint32_t>((room - 64) / 1.25));
    avatar.make_room(found);
    avatar.drive_into(queue);
    Resident<TwoStream<float, E>, IdleDevice> gradient(IdleDevice{}, queue, avatar.layout());
    avatar.vjp_into(queue, gradient);
    const double parameters = static_cast<double>(avatar.parameters().bytes());
    // Beside the avatar's own: what its other renders show, and their gradients.
    const double channels = config.avatar.channels;
    const double shown = 4 * ((sizes.face + sizes.eyes) * (14 + 3) + sizes.eyes * (14 + channels));
    const double held = static_cast<double>(avatar.bytes()) - parameters + shown;
    const DeviceNeed need = device_need(config, sizes);
    const double stated = part(need, "networks");
    MESSAGE("stated " << stated / 1e6 << " MB of networks, held " << held / 1e6 << " MB");
    CHECK(stated == doctest::Approx(held).epsilon(0.01));
    CHECK(part(need, "parameters, gradient and moments") ==
          doctest::Approx(4 * parameters).epsilon(0.001));
}

} // namespace

TEST_CASE("device: what is stated of an avatar is what it holds") {
    const DeviceSizes sizes{30000, 8000, {20000, 25000, 4000, 4500}, 32, 576, 512, 512, false};
    for (const std::string name : {"cpu", "gpu", "paper", "paper-literal"}) {
        CAPTURE(name);
        TrainConfig c = preset(name);
        c.avatar.expression = 64;
        c.gaze_mechanism = GazeMechanismName::rotation;
        c.eye_appearance = EyeAppearanceName::free;
        c.shading = ShadingName::none;
        const Avatar host = avatar_of(c, sizes);
        stated_is_held<1>(c, sizes, host);
        stated_is_held<3>(c, sizes, host);
        c.eye_appearance = EyeAppearanceName::driven;
        c.shading = ShadingName::head_pose;
        stated_is_held<1>(c, sizes, lit_avatar_of(c, sizes));
    }
}
