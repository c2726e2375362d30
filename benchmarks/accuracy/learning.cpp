// SPDX-License-Identifier: Apache-2.0
// Cost of low precision in training: an MLP's values and gradients in float and with weights of 16
// bits (bf16, sums in float) against double; and ways to sum a gradient of a million terms.
#include <bit>
#include <chrono>
#include <cmath>

#include <rye/core/parallel.hpp>
#include <rye/core/random.hpp>
#include <rye/nn/mlp.hpp>
#include <rye/splat/lanes.hpp>

#include "scenes.hpp"
#include "table.hpp"

namespace rye::bench {
namespace {

/// To the nearest of the 16 upper bits, ties to even.
float bf16(float x) {
    auto b = std::bit_cast<std::uint32_t>(x);
    b += 0x7FFFU + ((b >> 16U) & 1U);
    return std::bit_cast<float>(b & 0xFFFF0000U);
}

double relative(const Columns<double>& a, const Columns<double>& b) {
    return (a - b).norm() / b.norm();
}

template <class F>
double least_seconds(const F& f) {
    double least = INFINITY;
    for (int i = 0; i < 7; ++i) {
        const auto a = std::chrono::steady_clock::now();
        f();
        const auto b = std::chrono::steady_clock::now();
        least = std::min(least, std::chrono::duration<double>(b - a).count());
    }
    return least;
}

void mlp_precision() {
    using B = XsimdBackend<DefaultArch, Serial>;
    const MlpShape shape{{27, 64, 64, 64, 32}, 0};
    const Index points = 4096;
    const Mlp<float> net = Mlp<float>::init(shape, Random{1, 0});
    Columns<float> x(27, points), w(32, points);
    for (Index i = 0; i < x.size(); ++i)
        x.data()[i] = static_cast<float>(Random{2, 0}.normal(std::uint64_t(i)));
    for (Index i = 0; i < w.size(); ++i)
        w.data()[i] = static_cast<float>(Random{3, 0}.normal(std::uint64_t(i)));
    Mlp<double> truth(shape);
    convert_fields(truth, net, [](float v) { return static_cast<double>(v); });
    const auto run = [&](const auto& m, const auto& in, const auto& g, auto& value, auto& grad) {
        using T = typename std::decay_t<decltype(in)>::Scalar;
        MlpTrace<T> trace;
        value = mlp_forward(B{}, m, in, VecX<T>(), &trace);
        grad = zeros_like(m);
        mlp_vjp(B{}, m, {in, VecX<T>(), trace}, g, {grad});
    };
    Columns<double> y64;
    Mlp<double> g64(shape);
    const Columns<double> x64 = x.cast<double>(), w64 = w.cast<double>();
    run(truth, x64, w64, y64, g64);
    const double t64 = least_seconds([&] { run(truth, x64, w64, y64, g64); });
    const auto report = [&](const char* name, const Mlp<float>& m, const Columns<float>& in,
                            bool timed) {
        Columns<float> y;
        Mlp<float> g(shape);
        const double t = least_seconds([&] { run(m, in, w, y, g); });
        double worst = 0;
        for (std::size_t l = 0; l < g.weight.size(); ++l)
            worst = std::max(worst, relative(g.weight[l].cast<double>(), g64.weight[l]));
        std::printf("mlp %-34s value %.1e, gradient %.1e, ", name, relative(y.cast<double>(), y64),
                    worst);
        if (timed)
            std::printf("time %.2f of double's\n", t / t64);
        else
            std::printf("no time: rounded in software, no kernel multiplies bf16\n");
    };
    std::printf("mlp 27-64-64-64-32, %td points, against double\n", points);
    report("float", net, x, true);
    Mlp<float> half = net;
    Mlp<float>::fields([](const std::string&, auto& a) { a = a.unaryExpr(&bf16).eval(); }, half);
    const Columns<float> half_x = x.unaryExpr(&bf16);
    report("bf16 weights and inputs, float sums", half, half_x, false);
}

void accumulation() {
    const Index n = 1 << 20;
    Columns<float> g(1, n);
    long double truth = 0, size = 0;
    for (Index i = 0; i < n; ++i) {
        g(0, i) = static_cast<float>(1e-3 * Random{5, 0}.normal(std::uint64_t(i)) + 1e-5);
        truth += g(0, i);
        size += std::abs(g(0, i));
    }
    std::printf("a gradient of %td terms: error over the sum of magnitudes\n", n);
    const float* p = g.data();
    const auto report = [&](const char* name, const auto& sum, double& base) {
        double value = 0;
        const double t = least_seconds([&] { value = static_cast<double>(sum()); });
        if (base == 0) base = t;
        std::printf("sum %-34s %.1e, time %.2f of the first\n", name,
                    static_cast<double>(std::abs(value - truth) / size), t / base);
    };
    double base = 0;
    report(
        "one float",
        [&] {
            float s = 0;
            for (Index i = 0; i < n; ++i) s += p[i];
            return s;
        },
        base);
    report(
        "one float, Kahan",
        [&] {
            float s = 0, c = 0;
            for (Index i = 0; i < n; ++i) {
                const float y = p[i] - c, t = s + y;
                c = (t - s) - y;
                s = t;
            }
            return s;
        },
        base);
    report(
        "fixed chunks of 256 floats (rye's)",
        [&] {
            return sum_chunks(Serial{}, n, 256, 0.0F, [&](Index b, Index e) {
                return Eigen::Map<const VecX<float>>(p + b, e - b).sum();
            });
        },
        base);
    report(
        "one double",
        [&] {
            double s = 0;
            for (Index i = 0; i < n; ++i) s += static_cast<double>(p[i]);
            return s;
        },
        base);
}

/// Sums over pixels of every Gaussian's cotangents, computed in T and summed in S.
template <class T, class S>
struct SlotSums {
    Gaussians<T> g;
    Pinhole<T> camera;
    VecX<T> background;
    Columns<T> w;
    Raster<T> raster;
    RasterScratch<S> scratch;
    Columns<double> sums;    ///< SplatCotangent and features x Gaussians

    template <class A>
    SlotSums(const Scenery& s, const A& accuracy, const Columns<float>& weights)
        : camera(s.camera.cast<T>()), background(s.background.cast<T>()), w(weights.cast<T>()) {
        convert_fields(g, s.gaussians, [](float x) { return static_cast<T>(x); });
        raster = Rasterizer<A>{accuracy}.forward(ScalarBackend<Serial>{}, g, camera, background);
        walk(accuracy);
    }
    template <class A>
    void walk(const A& accuracy) {
        const TileLists& lists = raster.trace.lists;
        const Scene<T> scene{raster.trace, g,            background,   camera.cx,
                             camera.cy,    camera.width, camera.height};
        scratch.slots.shape(lists.entries(), g.channels());
        std::vector<PixelContribution<T>> hits;
        for (Index t = 0; t < lists.tiles(); ++t)
            blend_tile_vjp(scene, accuracy, {RasterCotangent<T>{w}, t}, scratch, hits);
        sums = Columns<double>::Zero(scratch.slots.stride, g.count());
        std::vector<S> sum(static_cast<std::size_t>(scratch.slots.stride));
        for (std::size_t m = 0; m < raster.trace.members.size(); ++m) {
            merge_slots(lists, scratch.slots, static_cast<Index>(m), sum.data());
            for (std::size_t k = 0; k < sum.size(); ++k)
                sums(static_cast<Index>(k), raster.trace.members[m].source) =
                    static_cast<double>(sum[k]);
        }
    }
};

/// Error of a rasterizer's gradient by summing in float.
void slot_precision() {
    for (const Scenery& s : {accuracy_head(), random_cloud("huge", 60, 23, 5)}) {
        Columns<float> w(3, Index(s.camera.width) * s.camera.height);
        for (Index i = 0; i < w.size(); ++i)
            w.data()[i] = static_cast<float>(Random{4, 0}.normal(std::uint64_t(i)));
        const Exact32 rules;
        const SlotSums<double, double> truth(s, rules, w);
        SlotSums<float, float> narrow(s, rules, w);
        SlotSums<float, double> wide(s, rules, w);
        const double t_narrow = least_seconds([&] { narrow.walk(rules); });
        const double t_wide = least_seconds([&] { wide.walk(rules); });
        const auto group = [&](const Columns<double>& sums, Index from, Index rows) {
            return relative(sums.middleRows(from, rows), truth.sums.middleRows(from, rows));
        };
        const auto line = [&](const char* name, const Columns<double>& sums, double time) {
            std::printf("slots of %-8s centre %.1e, shape %.1e, opacity %.1e, colour %.1e, "
                        "time %.2f of the first\n",
                        name, group(sums, 0, 2), group(sums, 2, 3), group(sums, 5, 1),
                        group(sums, 8, 3), time / t_narrow);
        };
        std::printf("%s: float contributions of plain loops, summed over pixels and tiles\n",
                    s.name.c_str());
        line("float", narrow.sums, t_narrow);
        line("double", wide.sums, t_wide);
    }
}

} // namespace

void learning() {
    mlp_precision();
    accumulation();
    slot_precision();
}

} // namespace rye::bench
