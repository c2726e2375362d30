// SPDX-License-Identifier: Apache-2.0
// Cost of each effect of the image: the time of a render with it over that without it, and, where
// there is one, of the render's vjp. Both alternate, each as often first as second; the median of
// the ratios of neighbours; one thread; 20000 Gaussians in 256 x 256 pixels.
#include <benchmark/benchmark.h>

#include <rye/gaussian/activate.hpp>
#include <rye/nn/upsampler.hpp>
#include <rye/splat/lanes.hpp>

#include "../splatting/work.hpp"
#include "turns.hpp"

namespace {

using namespace rye;
using namespace rye::bench;

using B = OneThread;
constexpr Index points = 20000;
constexpr int size = 256, rounds = 20;

template <Antialias choice>
struct Smoothed : Balanced {
    static constexpr Antialias antialias = choice;
};

/// A render of a number of channels, and its vjp.
template <AccuracyPolicy A = Balanced>
Work<B, A> picture(int channels = 3) {
    return {head_scene(points, channels, size)};
}

template <class With, class Without>
void compare(benchmark::State& state, With&& with, Without&& without) {
    Turns forward, backward;
    for (auto _ : state)
        for (int r = 0; r < rounds; ++r) {
            forward.time([&] { with.forward(); }, [&] { without.forward(); });
            backward.time([&] { with.backward(); }, [&] { without.backward(); });
        }
    state.counters["forward_ratio"] = forward.ratio();
    state.counters["vjp_ratio"] = backward.ratio();
}

template <Antialias with, Antialias without>
void antialias(benchmark::State& state) {
    compare(state, picture<Smoothed<with>>(), picture<Smoothed<without>>());
}
// Two equal pieces of work: the noise of a ratio.
BENCHMARK(antialias<Antialias::dilate, Antialias::dilate>)->Name("picture/nothing")->Iterations(1);
BENCHMARK(antialias<Antialias::dilate, Antialias::none>)
    ->Name("picture/antialias_dilate")
    ->Iterations(1);
BENCHMARK(antialias<Antialias::mip, Antialias::none>)
    ->Name("picture/antialias_mip")
    ->Iterations(1);

/// Features, alpha and another image, over features and alpha.
template <Outputs more>
void outputs(benchmark::State& state) {
    compare(state, picture<Drawing<Balanced, more>>(), picture<FeaturesOnly<Balanced>>());
}
BENCHMARK(outputs<Outputs{.depth = true, .contributor = false}>)
    ->Name("picture/depth")
    ->Iterations(1);
BENCHMARK(outputs<Outputs{.depth = false, .contributor = true}>)
    ->Name("picture/contributor")
    ->Iterations(1);

/// N channels, over 3.
void channels(benchmark::State& state) {
    compare(state, picture(static_cast<int>(state.range(0))), picture(3));
}
BENCHMARK(channels)->Name("picture/channels")->Arg(4)->Arg(8)->Arg(16)->Arg(32)->Iterations(1);

/// A coloured background, over a black one.
void background(benchmark::State& state) {
    auto coloured = picture(), black = picture();
    coloured.scene.background << 0.9F, 0.3F, 0.1F;
    compare(state, coloured, black);
}
BENCHMARK(background)->Name("picture/background")->Iterations(1);

/// Bands up to `most` of a cloud that has all four, over the constant alone. `activation_ratio` is
/// that of the stage of colours, `forward_ratio` of that and the render.
template <int most>
void harmonics(benchmark::State& state) {
    auto some = picture(), none = picture();
    GaussianCloud<float> cloud(points, 4);
    const Gaussians<float>& g = some.scene.gaussians;
    cloud.mean = g.mean;
    cloud.rotation = g.rotation;
    cloud.log_scale = g.scale.array().log();
    cloud.logit_opacity = (g.opacity.array() / (1 - g.opacity.array())).log();
    cloud.sh_constant = g.feature;
    Stream noise{0x5AFEULL};
    for (Index i = 0; i < cloud.sh_rest.size(); ++i)
        cloud.sh_rest(i) = static_cast<float>(0.1 * noise.normal());
    const Vec3<float> eye = some.scene.camera.centre();
    Turns activation, forward;
    for (auto _ : state)
        for (int r = 0; r < rounds; ++r) {
            const auto activate_with = [&] { some.scene.gaussians = activate<most>(cloud, eye); };
            const auto activate_without = [&] { none.scene.gaussians = activate<0>(cloud, eye); };
            activation.time(activate_with, activate_without);
            forward.time(
                [&] { activate_with(), some.forward(); },
                [&] { activate_without(), none.forward(); });
        }
    state.counters["activation_ratio"] = activation.ratio();
    state.counters["forward_ratio"] = forward.ratio();
}
BENCHMARK(harmonics<0>)->Name("picture/sh_bands/0")->Iterations(1);
BENCHMARK(harmonics<1>)->Name("picture/sh_bands/1")->Iterations(1);
BENCHMARK(harmonics<2>)->Name("picture/sh_bands/2")->Iterations(1);
BENCHMARK(harmonics<3>)->Name("picture/sh_bands/3")->Iterations(1);
BENCHMARK(harmonics<4>)->Name("picture/sh_bands/4")->Iterations(1);

/// A network after the render, over the render alone, with as many channels.
void super_resolution(benchmark::State& state, const UpsamplerShape& shape) {
    const Upsampler<float> network = Upsampler<float>::init(shape, Random{3, 0});
    auto with = picture(shape.in_channels), without = picture(shape.in_channels);
    Image<float> high;
    Turns forward;
    for (auto _ : state)
        for (int r = 0; r < 5; ++r)
            forward.time(
                [&] {
                    with.forward();
                    high = upsampler_forward(B{}, network, with.raster.feature, nullptr);
                },
                [&] { without.forward(); });
    state.counters["forward_ratio"] = forward.ratio();
}
/// `rye train --preset cpu` keeps the size; the published network enlarges each side 4 times.
const UpsamplerShape of_cpu{8, 8, 0, Normalization::none, true};
BENCHMARK_CAPTURE(super_resolution, cpu, of_cpu)
    ->Name("picture/super_resolution/preset_cpu")
    ->Iterations(1);
BENCHMARK_CAPTURE(super_resolution, published, UpsamplerShape())
    ->Name("picture/super_resolution/published")
    ->Iterations(1);

} // namespace
