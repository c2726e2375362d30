// SPDX-License-Identifier: Apache-2.0
// A training step of stage 2 with half the Gaussians of `rye train --preset cpu`, without any file:
// the time of its parts, the ratio to its networks' products alone at the peak measured in the same
// run, what of them is on one thread, and the speed-up by threads of the step, of each part, and of
// the machine's own products and bytes.
#include <benchmark/benchmark.h>
#ifdef __GLIBC__
#include <malloc.h>
#endif

#include <algorithm>
#include <map>
#include <string>

#include <rye/avatar/hold.hpp>
#include <rye/core/thread_pool.hpp>
#include <rye/loss/smoothness.hpp>
#include <rye/nn/adam.hpp>
#include <rye/splat/lanes.hpp>
#include <rye/train/avatar_trainer.hpp>

#include "../effects/subject.hpp"
#include "../roofline/clock.hpp"
#include "peak.hpp"

namespace {

using namespace rye;
using namespace rye::bench;

/// Wall time within calls of the threads so far [s]; a step makes them one after the other.
double inside_calls = 0;

/// A pool's threads that note how long they were called.
struct Noted {
    ThreadPool::Handle threads;

    template <std::invocable<Index> F>
    void run(Index n, F&& f) const {
        const double begin = wall_seconds();
        threads.run(n, f);
        inside_calls += wall_seconds() - begin;
    }
    int size() const { return threads.size(); }
};
static_assert(Threads<Noted>);

using B = XsimdBackend<DefaultArch, Noted>;

/// The pool of n threads.
B on_threads(int n) {
    static std::map<int, ThreadPool> pools;
    return {Noted{pools.try_emplace(n, n).first->second.threads()}};
}
using Avatar = TwoStream<float>;

/// The minimum times of a step and of each of its parts; a round is several steps.
struct LeastTimes {
    explicit LeastTimes(double (*c)()) : clock(c) {}
    double (*clock)();
    std::map<std::string, double> parts, alone; ///< alone: outside of all calls of the threads
    double step = 1e30, wall = 1e30;            ///< on the clock, on the wall

    void begin_round() {
        now_.clear();
        now_inside_.clear();
        wall_begin_ = wall_seconds();
    }
    void begin_step() {
        last_ = clock();
        last_inside_ = inside_calls;
    }
    void end_round(int steps) {
        double sum = 0;
        const auto lower = [&](std::map<std::string, double>& least, const std::string& part,
                               double seconds) {
            const auto [place, fresh] = least.try_emplace(part, 1e30);
            place->second = std::min(place->second, seconds / steps);
        };
        for (const auto& [part, seconds] : now_) {
            lower(parts, part, seconds);
            lower(alone, part, seconds - now_inside_[part]);
            sum += seconds;
        }
        step = std::min(step, sum / steps);
        wall = std::min(wall, (wall_seconds() - wall_begin_) / steps);
    }
    void operator()(const char* part) {
        const double now = clock();
        now_[part] += now - last_;
        now_inside_[part] += inside_calls - last_inside_;
        begin_step();
    }

  private:
    std::map<std::string, double> now_, now_inside_;
    double last_ = 0, last_inside_ = 0, wall_begin_ = 0;
};

/// The weights of the preset (examples/trainer/data/config.cpp).
AvatarLossConfig preset_weights() {
    AvatarLossConfig w;
    w.dssim = 0.2;
    w.face_alone = 1.0;
    w.eye_high_every = 3;
    w.eye_smooth = 0.2;
    return w;
}

AvatarRates equal_rates() {
    AvatarRates r;
    for (double* rate : {&r.upsampler, &r.networks, &r.opacity, &r.scale, &r.position, &r.feature,
                         &r.rotation, &r.delta_pose, &r.eye_feature, &r.eye_offset, &r.kappa})
        *rate = 1e-4;
    return r;
}

/// The sample of a step: the subject with other drivers.
AvatarSample<float> sample_of(const Subject& s, const Rasterizer<Balanced>& rasterizer) {
    AvatarSample<float> sample;
    sample.drivers = restricted<PaperEffects>(s.drivers);
    sample.camera = s.camera;
    sample.background = s.background;
    sample.blank = VecX<float>::Constant(s.background.size(), 0.7F);
    Drivers<float> other = sample.drivers;
    other.expression *= -1;
    other.pose[0] += 0.1F;
    TwoStreamTrace<float> trace;
    const B backend = on_threads(1);
    drive(backend, restricted<PaperEffects>(s.avatar), {s.config, s.roles, other}, trace);
    const Raster<float> shown = rasterizer.forward(
        backend, trace.gaussians, s.camera, s.background);
    const Raster<float> eyes =
        rasterizer.forward(backend, trace.eye_gaussians(), s.camera, s.background);
    sample.truth = upsampler_forward(backend, s.avatar.upsampler, shown.feature, nullptr);
    sample.truth_small = sample.truth;
    sample.mask_small = shown.alpha.pixels;
    sample.visible = sample.visible_small = Columns<float>::Ones(1, sample.truth.size());
    sample.eyes = Columns<float>::Zero(1, sample.truth.size());
    for (Index i = 0; i < sample.eyes.size(); ++i)
        if (eyes.alpha.pixels(i) > 0.5F) sample.eyes(i) = 1;
    sample.eyes_small = sample.eyes;
    return sample;
}

/// Flops of the products of the face's networks in a step, forward and reverse.
double network_flops(const Avatar& avatar, const FaceTrace<float>& trace) {
    double flops = 0;
    const auto add = [&](const Mlp<float>& m, const FieldTrace<float>& field) {
        const MlpShape& s = m.shape;
        double weights = 0;
        for (int l = 0; l < s.layers(); ++l)
            weights += double(s.layer_out(l)) *
                       (s.hidden_in(l) + (s.reads_input(l) ? s.point_inputs() : 0));
        flops += 3 * 2 * weights * double(field.set.size());
    };
    for_face_fields<PaperEffects>([&](auto by) {
        add(by.color(avatar.face.networks), by.color(trace));
        add(by.deform(avatar.face.networks), by.deform(trace));
    });
    for_attribute_fields<PaperEffects>(
        [&](auto by) { add(by.attribute(avatar.face), by.attribute(trace)); });
    return flops;
}

/// With a correction of the head pose, as in training.
Avatar with_delta_pose(Avatar avatar) {
    avatar.delta_pose = Columns<float>::Zero(6, 1);
    return avatar;
}

struct Trainer {
    const Subject& s = subject();
    Avatar avatar = with_delta_pose(restricted<PaperEffects>(s.avatar));
    Adam<Avatar> adam{avatar};
    AvatarSample<float> sample = sample_of(s, Rasterizer<Balanced>{});
    AvatarTrainer<B, float, PaperEffects, Balanced, PyramidGradientLoss, AvatarRates> trainer{
        on_threads(1), avatar, adam,
        {.config = s.config, .roles = s.roles, .objective = {.weights = preset_weights()},
         .rates = equal_rates()}};

    /// A step with the high-resolution eye term and the following ones without.
    void round(LeastTimes& times) {
        const int steps = preset_weights().eye_high_every;
        times.begin_round();
        for (int i = 0; i < steps; ++i) {
            sample.eyes_high = i == 0;
            times.begin_step();
            trainer.step(sample, 1, times);
        }
        times.end_round(steps);
    }
};

/// The least times of steps with one and with `threads` threads, alternating.
struct Alternating {
    LeastTimes serial{thread_seconds}, times{wall_seconds};

    void run(Trainer& trainer, int threads) {
        for (int round = 0; round < 8; ++round)
            for (const int n : {1, threads}) {
                trainer.trainer.backend = on_threads(n);
                trainer.round(n == 1 ? serial : times);
            }
        if (threads == 1) times = serial;
    }
};

/// A part's name as that of a counter.
std::string counter_name(std::string part) {
    std::replace_if(part.begin(), part.end(), [](char c) { return c == ' ' || c == '-'; }, '_');
    return part;
}

void step(benchmark::State& state) {
    const int threads = static_cast<int>(state.range(0));
    Trainer trainer;
    Alternating both;
    const double peak = measured_peak();
    double flops = 0;
    for (auto _ : state) {
        both.run(trainer, threads);
        flops = network_flops(trainer.avatar, trainer.trainer.trace().face);
    }
    const LeastTimes& times = both.times;
    state.counters["step_ms"] = 1e3 * times.step;
    state.counters["gaussians"] = double(trainer.trainer.trace().gaussians.count());
    state.counters["gflop"] = 1e-9 * flops;
    state.counters["over_products"] = times.step * peak * threads / flops;
    state.counters["faster"] = both.serial.wall / times.wall;
    for (const auto& [part, seconds] : times.parts)
        state.counters[counter_name(part)] = seconds / times.step;
    double alone = 0;
    for (const auto& [part, seconds] : times.alone) alone += seconds;
    state.counters["on_one_thread"] = alone / times.step;
    if (threads > 1)
        for (const auto& [part, seconds] : times.alone)
            state.counters["on_one_thread_" + counter_name(part)] = seconds / times.step;
}

/// The speed-up of a step and of each part by threads, in wall time.
void faster(benchmark::State& state) {
    Trainer trainer;
    Alternating both;
    for (auto _ : state) both.run(trainer, static_cast<int>(state.range(0)));
    state.counters["step"] = both.serial.wall / both.times.wall;
    for (const auto& [part, seconds] : both.times.parts)
        state.counters[counter_name(part)] = both.serial.parts[part] / seconds;
}

/// Measures the machine's own gain of n threads, a bound for everything above.
void machine(benchmark::State& state) {
    Together together{};
    for (auto _ : state) together = measured_together(static_cast<int>(state.range(0)));
    state.counters["products"] = together.products;
    state.counters["bytes"] = together.bytes;
}

void by_threads(benchmark::internal::Benchmark* b) {
    for (int t = 1; t <= std::max(2, ThreadPool().size()); t *= 2) b->Arg(t);
}
BENCHMARK(step)->ArgName("threads")->Apply(by_threads)->Iterations(1);
BENCHMARK(faster)->ArgName("threads")->Apply(by_threads)->Iterations(1);
BENCHMARK(machine)->ArgName("threads")->Apply(by_threads)->Iterations(1);

} // namespace

int main(int argc, char** argv) {
#ifdef __GLIBC__
    // Freed pages are kept, as by the trainer.
    mallopt(M_MMAP_THRESHOLD, 1 << 30);
    mallopt(M_TRIM_THRESHOLD, 1 << 30);
#endif
    benchmark::Initialize(&argc, argv);
    benchmark::RunSpecifiedBenchmarks();
}
