// SPDX-License-Identifier: Apache-2.0
// The sum at one pixel: clamps, stops, transmittance, cancellation (B1-B5, B9, B15, B16).
#include <limits>

#include "screens.hpp"

namespace rye::hard {
namespace {

/// The centre of the image, channel c.
template <class T>
double centre(const Raster<T>& r, int c = 0) {
    return double(r.feature.at(4, 4)[c]);
}

template <class B, class T>
void b1(Report& report) {
    // d image / d opacity by the vjp, and by a difference, on both sides of the clamp.
    double worst = 0, leak = 0;
    for (const double side : {-1.0, 1.0}) {
        Balanced clamped;
        clamped.alpha_max = 0.9;
        const T o = static_cast<T>(0.9 * (1 + side * 1e-3));
        auto s = layers<T>(1, 1, o);
        s.camera.width = s.camera.height = 1;
        s.camera.cx = s.camera.cy = T(0.5);
        const auto r = draw<B>(s, clamped);
        const double g = double(pull<B>(s, r, clamped).opacity(0, 0));
        worsen(worst, std::abs(g - (side > 0 ? 0.0 : 1.0)));
        if (side > 0) leak = std::abs(g - 1);
    }
    report.at_most("B1", kind<B, T>(), "alpha = clamp (1 -+ 1e-3): gradient 1 inside, 0 beyond",
                   1e-5, worst);
    report.textbook("B1", kind<B, T>(), "gradient passed through the clamp", 1e-5, leak);
}

template <class B, class T>
void b3_b4(Report& report) {
    // Layers that leave T = 0.0099, then a white one of 0.99, on black.
    auto s = layers<T>(2, 1, T(0.99));
    s.gaussians.feature << T(0), T(1);
    s.gaussians.opacity << T(1 - 0.0099), T(0.99);
    Balanced inclusive;
    inclusive.stop = 1e-4;
    const double truth = 0.0099 * 0.99;
    report.at_most("B3", kind<B, T>(), "T = 0.0099, then 0.99, stop 1e-4: error of the pixel",
                   1e-4 * (1 + 4 * unit<T>)+3e-6, std::abs(centre(draw<B>(s, inclusive)) - truth));
    // The exclusive rule leaves the last layer out: T (1 - alpha) < stop.
    const double exclusive = 0.0099 * 0.01 < 1e-4 ? 0.0 : truth;
    report.textbook("B3", kind<B, T>(), "stop before the layer that goes below 1e-4", 1e-4,
                    std::abs(exclusive - truth));

    // B4: 200 layers of 0.5, then an opaque one, no stop: every layer keeps its gradient.
    const Index n = 201;
    auto deep = layers<T>(n, 1, T(0.5));
    deep.gaussians.opacity(0, n - 1) = T(1);
    for (Index i = 0; i < n; ++i) deep.gaussians.feature(0, i) = static_cast<T>(i % 3);
    deep.camera.width = deep.camera.height = 1;
    deep.camera.cx = deep.camera.cy = T(0.5);
    Balanced open;
    open.stop = 0;
    open.alpha_max = 1;
    const auto r = draw<B>(deep, open);
    const auto g = pull<B>(deep, r, open);
    // d / d feature of layer i is T_i alpha_i = 2^-(i + 1).
    double worst = 0;
    for (Index i = 0; i < 100; ++i)
        worsen(worst, std::abs(double(g.feature(0, i)) * std::ldexp(1.0, int(i) + 1) - 1));
    report.at_most("B4", kind<B, T>(), "200 layers of 0.5, an opaque last: T_i of the gradient",
                   1e-4, worst);
    T rebuilt = T(1) - r.alpha.pixels(0, 0); // T_end = 1 - alpha, divided back up
    for (Index i = n - 1; i >= 0; --i)
        rebuilt /= std::max(T(1) - deep.gaussians.opacity(0, i), std::numeric_limits<T>::min());
    report.textbook("B4", kind<B, T>(), "T rebuilt from 1 - alpha by division: T_0 = 1", 1e-4,
                    std::abs(double(rebuilt) - 1));
}

template <class B, class T>
void b5(Report& report) {
    // Colours that differ from those behind by 1e-4: d/d alpha = T (c - behind).
    const Index n = 40;
    auto s = layers<T>(n, 1, T(0.1));
    s.camera.width = s.camera.height = 1;
    s.camera.cx = s.camera.cy = T(0.5);
    s.background.setConstant(T(0.5));
    for (Index i = 0; i < n; ++i)
        s.gaussians.feature(0, i) = static_cast<T>(
            0.5 + 1e-4 * (Random{5, 0}.uniform(static_cast<std::uint64_t>(i)) - 0.5));
    Balanced exact = Exact32();
    const auto g = pull<B>(s, draw<B>(s, exact), exact);
    double behind = double(s.background[0]), worst = 0, textbook = 0, largest = 0;
    std::vector<double> truth(static_cast<std::size_t>(n));
    for (Index i = n - 1; i >= 0; --i) {
        const double c = double(s.gaussians.feature(0, i)), a = double(s.gaussians.opacity(0, i));
        truth[static_cast<std::size_t>(i)] = std::pow(1 - a, double(i)) * (c - behind);
        largest = std::max(largest, std::abs(truth[static_cast<std::size_t>(i)]));
        behind += a * (c - behind);
    }
    // The buffer form: total minus the accumulated part, over 1 - alpha.
    T sum = T(0), t = T(1), total = T(0);
    for (Index i = 0; i < n; ++i) {
        total += t * s.gaussians.opacity(0, i) * s.gaussians.feature(0, i);
        t *= T(1) - s.gaussians.opacity(0, i);
    }
    total += t * s.background[0];
    t = T(1);
    for (Index i = 0; i < n; ++i) {
        const T c = s.gaussians.feature(0, i), a = s.gaussians.opacity(0, i);
        sum += t * a * c;
        const T buffer = t * c - (total - sum) / (T(1) - a);
        worsen(textbook, std::abs(double(buffer) - truth[static_cast<std::size_t>(i)]) / largest);
        worsen(worst,
               std::abs(double(g.opacity(0, i)) - truth[static_cast<std::size_t>(i)]) / largest);
        t *= T(1) - a;
    }
    const double demanded = sizeof(T) == 4 ? 2e-3 : 1e-11;
    report.at_most("B5", kind<B, T>(), "colours within 1e-4 of each other: d/d opacity", demanded,
                   worst);
    if (sizeof(T) == 4)
        report.textbook("B5", kind<B, T>(), "T c - (total - sum) / (1 - alpha)", demanded,
                        textbook);
    s.gaussians.feature.setConstant(T(0.5));
    report.holds("B5", kind<B, T>(), "colours of the background: d/d opacity is exactly 0",
                 pull<B>(s, draw<B>(s, exact), exact).opacity.isZero(0));
}

template <class B, class T>
void b9(Report& report) {
    const T nan = std::numeric_limits<T>::quiet_NaN(), inf = std::numeric_limits<T>::infinity();
    auto clean = cloud<T>(12, 3, 9);
    auto without = clean;
    without.gaussians.opacity(0, 5) = T(0);
    const auto expected = draw<B>(without);
    bool silent = true, counted = true;
    for (const T bad : {nan, inf, T(-inf)}) {
        int input = 0;
        Gaussians<T>::fields(
            [&](const std::string& name, const Columns<T>& a) {
                for (Index row = 0; row < a.rows(); ++row, ++input) {
                    auto s = clean;
                    Gaussians<T>::fields(
                        [&](const std::string& n, Columns<T>& c) {
                            if (n == name) c(row, 5) = bad;
                        },
                        s.gaussians);
                    const auto r = draw<B>(s);
                    silent = silent && r.feature.pixels == expected.feature.pixels &&
                             r.alpha.pixels == expected.alpha.pixels;
                    counted = counted && r.trace.non_finite == 1;
                }
            },
            clean.gaussians);
        silent = silent && input == 14;
    }
    report.holds("B9", kind<B, T>(), "NaN, +-inf in each of 14 inputs: as if it were not there",
                 silent);
    report.holds("B9", kind<B, T>(), "the same: counted once", counted);
    report.textbook_fails("B9", kind<B, T>(), "fmin(0.99, NaN) is transparent",
                          std::fmin(T(0.99), nan) < T(0.5));
}

template <class B, class T>
void b15_b16(Report& report) {
    // 30000 of opacity 1 in 32 x 32: T reaches exactly 0 and stays finite.
    auto s = layers<T>(30000, 1, T(1));
    s.camera.width = s.camera.height = 32;
    s.camera.cx = s.camera.cy = T(16);
    for (Index i = 0; i < 30000; ++i) s.gaussians.mean(2, i) = static_cast<T>(i) * T(1e-4);
    Balanced open;
    open.alpha_max = 1;
    open.stop = 0;
    const auto r = draw<B>(s, open);
    const auto g = pull<B>(s, r, open);
    report.holds("B15", kind<B, T>(), "30000 opaque layers in 32 x 32: finite, gradient finite",
                 r.feature.pixels.allFinite() && g.opacity.allFinite() && g.mean.allFinite() &&
                     std::abs(centre(r) - 1) < 1e-6);
    const T batch = T(0); // product of a batch, divided out again
    report.textbook_fails("B15", kind<B, T>(), "T of a batch recovered as a quotient of products",
                          std::isfinite(batch / batch));
    // B16: value and weight are separate outputs, so an empty pixel needs no division.
    auto none = layers<T>(1, 1, T(0));
    const auto empty = draw<B>(none);
    report.holds("B16", kind<B, T>(), "empty pixel: depth 0, weight 0, background as it is",
                 empty.depth.pixels.isZero(0) && empty.alpha.pixels.isZero(0));
    report.textbook_fails("B16", kind<B, T>(), "depth / alpha of an empty pixel",
                          std::isfinite(empty.depth.pixels(0, 0) / empty.alpha.pixels(0, 0)));
}

/// The jump at the threshold, and the number of pixels that a step of 6e-6 moves across it.
template <class B, class T>
void b2(Report& report) {
    const auto s = cloud<T>(80, 3, 3);
    auto moved = s;
    const T h = T(6e-6);
    moved.gaussians.mean.array() += h;
    const auto a = draw<B>(s), b = draw<B>(moved);
    Index jumps = 0;
    for (Index p = 0; p < a.alpha.pixels.size(); ++p)
        if (std::abs(double(a.alpha.pixels(0, p) - b.alpha.pixels(0, p))) > 3e-4) ++jumps;
    report.at_most("B2", kind<B, T>(), "share of pixels that jump when all means move by 6e-6",
                   0.01, double(jumps) / double(a.alpha.pixels.size()));
}

} // namespace

void blending(Report& report) {
    every_backend([&]<class B, class T>() {
        b1<B, T>(report);
        b2<B, T>(report);
        b3_b4<B, T>(report);
        b5<B, T>(report);
        b9<B, T>(report);
        b15_b16<B, T>(report);
    });
}

} // namespace rye::hard
