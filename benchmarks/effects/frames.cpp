// SPDX-License-Identifier: Apache-2.0
// Time of incremental frames (interactive/frame_cache.hpp) relative to full frames, alternating in
// the same run, on one thread; and of the deformation stage by the fraction of points that a driver
// influences. Every timed frame is compared with the full one, bit by bit.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <vector>

#include <rye/interactive/frame_cache.hpp>

#include "../roofline/clock.hpp"
#include "subject.hpp"

namespace {

using namespace rye;
using namespace rye::bench;
using OneThread = XsimdBackend<DefaultArch, Serial>;
using Cache = FrameCache<OneThread, Balanced, float, TrainedEffects>;

/// The minimum time of f, and of other work timed between its calls.
struct Least {
    double seconds = 1e30;
    template <class F>
    void time(const F& f) {
        const double start = thread_seconds();
        f();
        seconds = std::min(seconds, thread_seconds() - start);
    }
};

/// A full frame, computed into allocated memory.
struct WholeFrame {
    TwoStreamTrace<float, TrainedEffects> trace;
    RasterScratch<float> scratch;
    Raster<float> raster;
    Image<float> picture;
    Least deform, render, upsample;

    void run(const Subject& s, const Drivers<float, TrainedEffects>& drivers, const Pinhole<float>& camera,
             const VecX<float>& background) {
        Gaussians<float> g;
        deform.time([&] {
            drive(OneThread{}, s.avatar, {s.config, s.roles, drivers}, trace);
            g = trace.gaussians;
        });
        render.time([&] {
            Rasterizer<>().forward_into(OneThread{}, g, camera, background, raster, &scratch);
        });
        upsample.time([&] {
            picture = upsampler_forward(OneThread{}, s.avatar.upsampler, raster.feature, nullptr);
        });
    }
    double seconds() const { return deform.seconds + render.seconds + upsample.seconds; }
};

bool same_picture(const WholeFrame& whole, Cache& cache) {
    const Raster<float>& kept = cache.render().raster();
    return same_bits(whole.raster.feature.pixels, kept.feature.pixels) &&
           same_bits(whole.raster.alpha.pixels, kept.alpha.pixels) &&
           same_bits(whole.raster.depth.pixels, kept.depth.pixels) &&
           same_bits(whole.picture.pixels, cache.picture().pixels);
}

/// Inputs of a frame.
struct Shot {
    Drivers<float, TrainedEffects> drivers;
    Pinhole<float> camera;
    VecX<float> background;
};

Vec3<float> looking(float step) {
    return Vec3<float>(0.25f * std::sin(step), 0.12f * std::cos(1.7f * step), 1).normalized();
}

/// Work that blending an updated image from the front cannot avoid.
struct LeastPairs {
    double changed = 0;  ///< fraction of pixel-Gaussian pairs in pixels whose bits changed
    double in_front = 0; ///< of these: fraction in front of the pixel's first Gaussian that moved
};

/// Counted by the plain loops. `before` is the render before the update.
LeastPairs least_pairs(const Raster<float>& before, const Cache& cache, const Shot& shot) {
    const Raster<float>& after = cache.render().raster();
    const Gaussians<float>& g = cache.drive().gaussians();
    std::vector<bool> moved(static_cast<std::size_t>(g.count()), false);
    for (const Index i : cache.drive().changed()) moved[static_cast<std::size_t>(i)] = true;
    const Scene<float> s = Rasterizer<>::scene_of(g, shot.camera, shot.background,
                                                           after.trace);
    double all = 0, changed = 0, in_front = 0;
    for (Index t = 0; t < after.trace.lists.tiles(); ++t)
        for (int y = s.top(t); y < s.bottom(t); ++y)
            for (int x = s.left(t); x < s.right(t); ++x) {
                double pairs = 0, front = 0;
                bool met = false;
                walk_pixel(s, Balanced(), {t, x, y}, [&](const PixelContribution<float>& h) {
                    met = met || moved[s.member(h.entry).source];
                    front += met ? 0 : 1;
                    ++pairs;
                });
                all += pairs;
                const Index p = s.pixel(x, y);
                const auto same = [&](const Image<float>& a, const Image<float>& b) {
                    return (a.pixels.col(p).array() == b.pixels.col(p).array()).all();
                };
                if (same(before.feature, after.feature) && same(before.alpha, after.alpha) &&
                    same(before.depth, after.depth))
                    continue;
                changed += pairs;
                in_front += front;
            }
    return {all > 0 ? changed / all : 0, changed > 0 ? in_front / changed : 0};
}

/// Rounds of: a full frame, the same by a cache that holds only the rest pose, and by one that
/// holds the previous frame. `next` makes the next frame from the previous one.
template <class Next>
void frames(benchmark::State& state, const Next& next) {
    const Subject& s = subject();
    const auto fresh = [&] { return Cache({}, s.avatar, s.config, s.roles); };
    Cache kept = fresh(), all = fresh();
    DriveCache<OneThread, float, TrainedEffects> driven({}, s.avatar, s.config, s.roles);
    Shot shot{s.drivers, s.camera, s.background};
    WholeFrame whole;
    Least deform, update, upsample, everything;
    DriveWork drive_work;
    RedrawWork render_work;
    Index pixels = 0;
    bool same = true;
    kept.update(shot.drivers, shot.camera, shot.background);
    kept.picture();
    driven.update(shot.drivers);
    for (auto _ : state)
        for (int round = 1; round <= 12; ++round) {
            next(shot, static_cast<float>(round));
            whole.run(s, shot.drivers, shot.camera, shot.background);
            deform.time([&] { driven.update(shot.drivers); });
            update.time([&] { kept.update(shot.drivers, shot.camera, shot.background); });
            upsample.time([&] { kept.picture(); });
            drive_work = kept.drive().work();
            render_work = kept.render().work();
            pixels = kept.upsampler().pixels();
            same = same && same_picture(whole, kept);
            // Changes everything, then updates to this frame.
            Shot other = shot;
            other.drivers.expression.array() += 0.01f;
            other.drivers.pose.array() += 0.001f;
            for (Vec3<float>& g : other.drivers.gaze) g = looking(static_cast<float>(round) + 9);
            other.camera.cx += 0.5f;
            all.update(other.drivers, other.camera, other.background);
            all.picture();
            everything.time([&] {
                all.update(shot.drivers, shot.camera, shot.background);
                all.picture();
            });
        }
    const Raster<float> before = kept.render().raster();
    next(shot, 13);
    kept.update(shot.drivers, shot.camera, shot.background);
    const LeastPairs least = least_pairs(before, kept, shot);
    const double mine = update.seconds + upsample.seconds;
    const double gaussians = static_cast<double>(s.avatar.face.position.cols() +
                                                 s.avatar.eyes.position.cols());
    auto& c = state.counters;
    c["faster"] = whole.seconds() / mine;
    c["faster_render"] = (whole.deform.seconds + whole.render.seconds) / update.seconds;
    c["than_all_changed"] = everything.seconds / mine;
    c["deform"] = deform.seconds / whole.deform.seconds;
    c["render"] = std::max(0.0, update.seconds - deform.seconds) / whole.render.seconds;
    c["upsample"] = upsample.seconds / whole.upsample.seconds;
    c["networks"] = static_cast<double>(drive_work.networks);
    c["projected"] = static_cast<double>(render_work.projected) / gaussians;
    c["tiles"] = static_cast<double>(render_work.blended) /
                 static_cast<double>(kept.render().raster().trace.lists.tiles());
    c["pixels"] = static_cast<double>(pixels) / static_cast<double>(kept.picture().size());
    c["pairs_changed"] = least.changed;
    c["pairs_in_front"] = least.in_front;
    c["same_bits"] = same ? 1 : 0;
    c["MB"] = static_cast<double>(kept.bytes()) * 1e-6;
}

void left_gaze(benchmark::State& state) {
    frames(state, [](Shot& s, float step) { s.drivers.gaze[0] = looking(step); });
}
void right_gaze(benchmark::State& state) {
    frames(state, [](Shot& s, float step) { s.drivers.gaze[1] = looking(step); });
}
void both_gazes(benchmark::State& state) {
    frames(state, [](Shot& s, float step) {
        s.drivers.gaze = {looking(step), looking(step + 0.1f)};
    });
}
void expression(benchmark::State& state) {
    frames(state, [](Shot& s, float step) { s.drivers.expression[0] = 0.03f * step; });
}
void head_pose(benchmark::State& state) {
    frames(state, [](Shot& s, float step) { s.drivers.pose[1] += 0.001f * step; });
}
void background(benchmark::State& state) {
    frames(state, [](Shot& s, float step) { s.background[0] = 0.05f * step; });
}
void camera(benchmark::State& state) {
    frames(state, [](Shot& s, float step) { s.camera.cx += 0.1f * step; });
}
void nothing(benchmark::State& state) {
    frames(state, [](Shot&, float) {});
}
BENCHMARK(left_gaze)->Iterations(1);
BENCHMARK(right_gaze)->Iterations(1);
BENCHMARK(both_gazes)->Iterations(1);
BENCHMARK(expression)->Iterations(1);
BENCHMARK(head_pose)->Iterations(1);
BENCHMARK(background)->Iterations(1);
BENCHMARK(camera)->Iterations(1);
BENCHMARK(nothing)->Iterations(1);

/// The far threshold of the expression's influence that includes `percent` of the points.
double threshold(const Subject& s, Index percent) {
    const Columns<float>& x = s.avatar.face.position;
    const Columns<float> d = nearest_squared_distance<float>(
        OneThread{}, x, pick_columns(s.avatar.face.landmarks, s.roles.expression), nullptr);
    std::vector<float> sorted(d.data(), d.data() + d.size());
    std::sort(sorted.begin(), sorted.end());
    const std::size_t k = sorted.size() * static_cast<std::size_t>(percent) / 100;
    return k == 0 ? 0 : k == sorted.size() ? 2.0 * sorted.back() : sorted[k];
}

/// Time of the deformation for a new expression, by the reach of the expression, relative to the
/// time with all points in reach.
void influence(benchmark::State& state) {
    Subject s = subject(), most = s;
    s.config.metric = most.config.metric = SquaredDistance{};
    s.config.exp_near = 0;
    s.config.exp_far = threshold(s, state.range(0));
    most.config.exp_near = 0;
    most.config.exp_far = threshold(s, 100);
    DriveCache<OneThread, float, TrainedEffects> some({}, s.avatar, s.config, s.roles),
        all({}, most.avatar, most.config, most.roles);
    some.update(s.drivers);
    all.update(s.drivers);
    Least part, whole;
    for (auto _ : state)
        for (int round = 1; round <= 15; ++round) {
            s.drivers.expression[0] = 0.02f * static_cast<float>(round);
            whole.time([&] { all.update(s.drivers); });
            part.time([&] { some.update(s.drivers); });
        }
    state.counters["points"] = static_cast<double>(some.rest().moved[0].points.size()) /
                               static_cast<double>(s.avatar.face.position.cols());
    state.counters["time"] = part.seconds / whole.seconds;
}
BENCHMARK(influence)->ArgName("percent")->Arg(0)->Arg(10)->Arg(50)->Arg(100)->Iterations(1);

} // namespace
