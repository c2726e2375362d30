// SPDX-License-Identifier: Apache-2.0
// The kernels of a device, run by its emulation on the host: the same text with a warp as an array
// of lanes. Phases run in order, backward and shuffled, so that a missing barrier shows.
#include <rye/splat/cuda/sh_color.hpp>

#include "../cuda/cases.hpp"
#include "../cuda/emulated.hpp"
#include "../cuda/jvp_cases.hpp"

using namespace rye;
using namespace rye::test;

namespace {

using Three = KernelChannels<3>;

} // namespace

TEST_CASE("cuda, emulated: hard scenes in every order of threads") {
    for (const auto order : phase_orders)
        for (const auto& s : hard_scenes<float>(3))
            against<float, Three>(EmulatedDevice{order}, host_queue, s, Balanced(),
                                  {2e-6, 2e-5, 2e-2});
}

TEST_CASE("cuda, emulated: lists equal the host's") {
    for (const auto& s : hard_scenes<float>(3))
        lists_equal<Balanced>(EmulatedDevice{}, host_queue, s);
    lists_equal<Balanced>(EmulatedDevice{}, host_queue, random_scene<float>(2000, 3, 5));
}

TEST_CASE("cuda, emulated: a crowded tile") {
    against<double, Three>(EmulatedDevice{PhaseOrder::shuffled}, host_queue, crowded(2500, true),
                           Balanced());
}

TEST_CASE("cuda, emulated: tall Gaussians") {
    lists_equal<Balanced>(EmulatedDevice{PhaseOrder::shuffled}, host_queue, tall(150, 3));
    against<double, Three>(EmulatedDevice{}, host_queue, tall(150, 3), Balanced());
}

TEST_CASE("cuda, emulated: lists in several passes") {
    const EmulatedDevice device{PhaseOrder::shuffled};
    in_passes<Three>(device, host_queue, random_scene<float>(1000, 3, 5));
    in_passes<Three>(device, host_queue, tall(150, 3));
}

TEST_CASE("cuda, emulated: a frame without a vjp") {
    without_vjp<Three>(EmulatedDevice{}, host_queue, 3);
    without_vjp<KernelChannels<16>>(EmulatedDevice{}, host_queue, 16);
}

TEST_CASE("cuda, emulated: features as halves") {
    halves_drawn<Three>(EmulatedDevice{}, host_queue, 3);
    halves_drawn<KernelChannels<16>>(EmulatedDevice{}, host_queue, 16);
    halves_drawn<KernelChannels<8>>(EmulatedDevice{PhaseOrder::shuffled}, host_queue, 11);
}

TEST_CASE("cuda, emulated: every half") {
    using H = detail::HostHalves;
    for (std::uint32_t h = 0; h < 0x10000U; ++h)
        if ((h & 0x7C00U) != 0x7C00U) {
            REQUIRE(H::half(H::whole(h)) == h);
            const float step = H::whole((h + 1) & 0x7FFFU) - H::whole(h & 0x7FFFU);
            if (h + 1 < 0x7C00U) {
                REQUIRE(H::half(H::whole(h) + 0.49F * step) == h);
                REQUIRE(H::half(H::whole(h) + 0.51F * step) == h + 1);
                REQUIRE(H::half(H::whole(h) + 0.5F * step) == h + (h & 1U));
            }
        }
    CHECK(H::half(1e9F) == 0x7BFFU);
    CHECK(H::half(-65520.0F) == 0xFBFFU);
    CHECK(H::half(1e-9F) == 0U);
    CHECK(H::half(1.0F) == 0x3C00U);
}

TEST_CASE("cuda, emulated: rules") {
    against<float, Three>(EmulatedDevice{}, host_queue, random_scene<float>(200, 3, 5),
                          Compatible3dgsFloor());
}

TEST_CASE("cuda, emulated: Fast where its rules decide clearly") {
    fast_where_decided<Three>(EmulatedDevice{}, host_queue, 3);
}

TEST_CASE("cuda, emulated: bad input") { bad_input(EmulatedDevice{}, host_queue); }

TEST_CASE("cuda, emulated: too little room") { too_little_room(EmulatedDevice{}, host_queue); }

TEST_CASE("cuda, emulated: too little memory") { too_little_memory(EmulatedDevice{}, host_queue); }

TEST_CASE("cuda, emulated: contributors") { contributors(EmulatedDevice{}, host_queue); }

TEST_CASE("cuda, emulated: channels as products of matrices") {
    for (const Index c : {5, 16, 20})
        against<double, KernelChannels<16>>(EmulatedDevice{PhaseOrder::shuffled}, host_queue,
                                            random_scene<float>(150, c, 5), Balanced(),
                                            {4e-6, 2e-5, 2e-5});
    equal_colours<KernelChannels<16>>(EmulatedDevice{}, host_queue, 16);
}
TEST_CASE("cuda, emulated: equal colours have no gradient of shape") {
    equal_colours<Three>(EmulatedDevice{}, host_queue, 3);
}
TEST_CASE("cuda, emulated: derivatives in directions") {
    const EmulatedDevice device{PhaseOrder::shuffled};
    const Scenery<float> s = random_scene<float>(200, 3, 5);
    jvp_against<double, Three>(device, host_queue, s, Balanced(), 5);
    jvp_against<float, Three>(device, host_queue, s, Compatible3dgsFloor(), 3);
    for (const Index c : {5, 16, 20})
        jvp_against<double, KernelChannels<16>>(
            device, host_queue, random_scene<float>(150, c, 5), Balanced(), 4);
    for (const auto& hard : hard_scenes<float>(3))
        jvp_against<float, Three>(device, host_queue, hard, Balanced(), 2);
    bad_directions(device, host_queue);
}
TEST_CASE("cuda, emulated: colours from harmonics are the host's") {
    const Index n = 150;
    GaussianCloud<float> cloud(n, 3), gradient(n, 3);
    cloud.mean = noise<float>(3, n, 1);
    cloud.sh_constant = noise<float>(3, n, 2);
    cloud.sh_rest = noise<float>(45, n, 3);
    const Vec3<float> eye(0.1F, 0.2F, -3);
    Columns<float> g_rgb = noise<float>(3, n, 4);
    g_rgb.rightCols(20).setZero(); // not read
    const EmulatedDevice device;
    const DeviceArray<EmulatedDevice> mean(device, host_queue, cloud.mean),
        constant(device, host_queue, cloud.sh_constant), rest(device, host_queue, cloud.sh_rest),
        rgb(device, host_queue, 3, n), g(device, host_queue, g_rgb),
        g_mean(device, host_queue, Columns<float>(Columns<float>::Zero(3, n))),
        g_constant(device, host_queue, 3, n), g_rest(device, host_queue, 45, n);
    const DeviceHarmonics<const float> in{mean.read(), constant.read(), rest.read()};
    sh_colors_into<3>(host_queue, device, in, eye, rgb.buffer.data());
    CHECK(rgb.get() == sh_colors<3>(cloud, eye));
    sh_colors_vjp_into<3>(host_queue, device, in, eye, g.buffer.data(),
                          {g_mean.view(), g_constant.view(), g_rest.view()});
    gradient.mean.setZero();
    sh_colors_vjp<3>(cloud, eye, g_rgb, gradient);
    CHECK(relative(g_mean.get(), gradient.mean) < 1e-6);
    CHECK(relative(g_constant.get(), gradient.sh_constant) < 1e-6);
    CHECK(relative(g_rest.get(), gradient.sh_rest) < 1e-6);
    CHECK(g_rest.get().rightCols(20).isZero(0));
    CHECK(g_constant.get().rightCols(20).isZero(0));
}
