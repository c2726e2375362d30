// SPDX-License-Identifier: Apache-2.0
// against_peer.cpp: rye beside another rasterizer (peer.hpp) on the scenes of bench_splatting, one
// thread each, in turn. Prints a table of times in ms, the least of ROUNDS (the first argument, 7),
// and how far the peer's picture and gradients are from rye's.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include <rye/splat/lanes.hpp>

#include "../../roofline/clock.hpp"
#include "../../roofline/load.hpp"
#include "../../scenes/head_scene.hpp"
#include "peer.hpp"

namespace {

using namespace rye;
using namespace rye::bench;
using OneThread = XsimdBackend<DefaultArch, Serial>;

/// rye by the rules of A.
template <AccuracyPolicy A>
struct Ours {
    Rasterizer<A> rasterizer = {};
    Raster<float, A::outputs> raster = {};
    RasterScratch<float> scratch = {};
    Gaussians<float> gradient = {};
    double forward = 1e30, both = 1e30;

    void round(const HeadScene& s) {
        const double begin = thread_seconds();
        rasterizer.forward_into(OneThread{}, s.gaussians, s.camera, s.background, raster, &scratch);
        const double middle = thread_seconds();
        rasterizer.vjp_into(OneThread{}, s.gaussians, s.camera, s.background, raster,
                            RasterCotangent<float>{s.cotangent}, gradient, &scratch);
        const double end = thread_seconds();
        forward = std::min(forward, middle - begin);
        both = std::min(both, end - begin);
    }
};

double psnr(const Columns<float>& a, const std::vector<float>& b) {
    double sum = 0;
    for (std::size_t i = 0; i < b.size(); ++i) {
        const double d = double(a.data()[i]) - double(b[i]);
        sum += d * d;
    }
    return -10 * std::log10(sum / static_cast<double>(b.size()));
}

/// The norm of the difference over the norm.
double relative(const Columns<float>& a, const std::vector<float>& b) {
    double difference = 0, norm = 0;
    for (std::size_t i = 0; i < b.size(); ++i) {
        const double x = double(a.data()[i]), d = x - double(b[i]);
        difference += d * d;
        norm += x * x;
    }
    return std::sqrt(difference / norm);
}

peers::Scene view_of_scene(const HeadScene& s) {
    const auto& g = s.gaussians;
    const auto& c = s.camera;
    peers::Scene out{static_cast<int>(g.count()), g.mean.data(), g.scale.data(), g.rotation.data(),
                     g.opacity.data(), g.feature.data(), c.width, c.height, c.fx, c.fy, c.cx, c.cy,
                     c.near_depth, {}};
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) out.view[4 * i + j] = c.camera_from_world.rotation(i, j);
        out.view[4 * i + 3] = c.camera_from_world.translation[i];
    }
    out.view[15] = 1;
    return out;
}

void print(const char* name, double forward, double both) {
    std::printf("  %-36s %8.2f %8.2f\n", name, forward, both);
}

void against(Index count, int rounds) {
    const HeadScene scene = head_scene(count, 3);
    const std::vector<float> cotangent(scene.cotangent.data(),
                                       scene.cotangent.data() + scene.cotangent.size());
    peers::prepare(view_of_scene(scene));
    Ours<Balanced> usual;
    Ours<HeadRules> same;  // the peer has them too
    peers::Seconds theirs{1e30, 1e30};
    double theirs_both = 1e30;
    peers::Picture picture;
    peers::Gradient gradient;
    LoadSeen load;
    for (int i = 0; i < rounds; ++i) {
        for (int k = 0; k < 5; ++k) {
            usual.round(scene);
            same.round(scene);
        }
        const peers::Seconds t = peers::forward(&picture);
        theirs = {std::min(theirs.project, t.project), std::min(theirs.forward, t.forward)};
        theirs_both = std::min(theirs_both, peers::both(cotangent, &gradient));
        load.look();
    }
    std::printf("%td Gaussians, 3 channels, %d x %d pixels, a load of %.1f\n", count,
                scene.camera.width, scene.camera.height, load.mean().average);
    std::printf("  %-36s %8s %8s\n", "", "forward", "both");
    print("rye, default policy [ms]", 1e3 * usual.forward, 1e3 * usual.both);
    print("rye, the peer's rules [ms]", 1e3 * same.forward, 1e3 * same.both);
    print("peer [ms]", 1e3 * theirs.forward, 1e3 * theirs_both);
    print("peer over rye, default policy", theirs.forward / usual.forward,
          theirs_both / usual.both);
    print("peer over rye, the peer's rules", theirs.forward / same.forward,
          theirs_both / same.both);
    std::printf("  the peer projects in %.2f of its forward's ms\n", 1e3 * theirs.project);
    std::printf("  PSNR of its picture: %.1f dB to rye's by its rules, %.1f dB to the default's\n",
                psnr(same.raster.feature.pixels, picture),
                psnr(usual.raster.feature.pixels, picture));
    std::printf("  its gradients, relative to rye's by its rules: mean %.1e, scale %.1e, rotation "
                "%.1e, opacity %.1e, colour %.1e\n",
                relative(same.gradient.mean, gradient.mean),
                relative(same.gradient.scale, gradient.scale),
                relative(same.gradient.rotation, gradient.rotation),
                relative(same.gradient.opacity, gradient.opacity),
                relative(same.gradient.feature, gradient.colour));
}

} // namespace

int main(int argc, char** argv) {
    const int rounds = argc > 1 ? std::atoi(argv[1]) : 7;
    std::printf("%s; %s, %d lanes; %d rounds in turn, one thread each\n",
                peers::version().c_str(), processor_name().c_str(),
                static_cast<int>(OneThread::batch<float>::size), rounds);
    against(20000, rounds);
    against(100000, rounds);
}
