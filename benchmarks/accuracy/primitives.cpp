// SPDX-License-Identifier: Apache-2.0
// Error of each function in units in the last place, over all floats of its range or over every
// 1009th of them, and its time for an array in the L1 cache.
#include <bit>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <limits>

#include <rye/backend/lanes.hpp>
#include <rye/core/columns.hpp>
#include <rye/math/exponential.hpp>
#include <rye/math/scalar.hpp>

#include "table.hpp"

namespace rye::bench {
namespace {

using V = XsimdBackend<>::batch<float>;
constexpr std::size_t lanes = V::size;

struct Range {
    float low, high;
    const char* text;
};

/// Ranges of a function: of its errors, and of its time.
struct Ranges {
    Range range, timed;
};

/// Nanoseconds per element: the minimum of several passes over 4096 numbers of the range.
template <class F>
double time_of(const F& f, const Range& r) {
    constexpr std::size_t n = 4096;
    alignas(64) static float x[n], y[n];
    for (std::size_t i = 0; i < n; ++i)
        x[i] = r.low + (r.high - r.low) * (static_cast<float>(i) + 0.5F) / static_cast<float>(n);
    double least = INFINITY;
    float sink = 0;
    for (int pass = 0; pass < 30; ++pass) {
        const auto a = std::chrono::steady_clock::now();
        for (int k = 0; k < 8; ++k) {
            f(x, y, n);
            sink += y[static_cast<std::size_t>(k)];
        }
        const auto b = std::chrono::steady_clock::now();
        least = std::min(least, std::chrono::duration<double>(b - a).count());
    }
    if (std::isnan(sink)) std::printf("NaN in a timed function\n");
    return least / 8 / n * 1e9;
}

/// Index of a float in the order of all floats.
std::int64_t rank(float x) {
    const auto b = static_cast<std::int64_t>(std::bit_cast<std::uint32_t>(x));
    return b >= 0x80000000LL ? 0x80000000LL - b : b;
}
float at_rank(std::int64_t r) {
    return std::bit_cast<float>(static_cast<std::uint32_t>(r < 0 ? 0x80000000LL - r : r));
}

template <class F, class G>
PrimitiveRow measure(const char* name, const F& f, const G& truth, const Ranges& ranges,
                     bool exhaustive) {
    const auto& [range, timed] = ranges;
    const std::int64_t step = exhaustive ? 1 : 1009;
    double ulp = 0, relative = 0;
    constexpr std::size_t n = 1024;
    alignas(64) float x[n], y[n];
    std::int64_t r = rank(range.low);
    const std::int64_t last = rank(range.high);
    while (r <= last) {
        std::size_t count = 0;
        for (; count < n && r <= last; ++count, r += step) x[count] = at_rank(r);
        for (std::size_t i = count; i < n; ++i) x[i] = x[0];
        f(x, y, n);
        for (std::size_t i = 0; i < count; ++i) {
            const double t = truth(static_cast<double>(x[i]));
            const double off = std::abs(static_cast<double>(y[i]) - t);
            const float a = std::abs(static_cast<float>(t));
            if (a < std::numeric_limits<float>::min()) continue;
            const double unit = std::ldexp(1.0, std::ilogb(a) - 23);
            if (!(off / unit <= ulp)) ulp = off / unit;        // keeps NaN
            if (!(off / std::abs(t) <= relative)) relative = off / std::abs(t);
        }
    }
    return {name, ulp, relative, time_of(f, timed), range.text, exhaustive};
}

/// A formula over lanes, as a pass over an array.
template <class F>
auto pass(const F& f) {
    return [f](const float* x, float* y, std::size_t n) {
        for (std::size_t i = 0; i < n; i += lanes) f(V::load_aligned(x + i)).store_aligned(y + i);
    };
}
template <class F>
auto scalar_pass(const F& f) {
    return [f](const float* x, float* y, std::size_t n) {
        for (std::size_t i = 0; i < n; ++i) y[i] = f(x[i]);
    };
}

} // namespace

std::vector<PrimitiveRow> primitives(const Settings& s) {
    const bool all = s.exhaustive;
    const Range alpha{-8, 0, "[-8, 0]"}, powers{-125, 0, "[-125, 0]"},
        wide{-80, 80, "[-80, 80]"};
    const Range turns{-39000, 39000, "[-39000, 39000]"}, positive{1e-37F, 1e37F, "[1e-37, 1e37]"};
    const Range near{-5, 5, "[-5, 5]"}, some{0.1F, 10, ""};
    std::vector<PrimitiveRow> rows;
    const auto add = [&](const char* name, const auto& f, const auto& truth, const Range& range,
                         const Range& timed) {
        rows.push_back(measure(name, f, truth, {range, timed}, all));
        const PrimitiveRow& r = rows.back();
        std::printf("%-28s %-16s %10.3g ulp %10.2e relative %8.3f ns\n", r.name.c_str(),
                    r.range.c_str(), r.ulp, r.relative, r.ns);
        std::fflush(stdout);
    };
    std::printf("primitives, %s floats of the range\n", all ? "all" : "every 1009th of the");
    const auto exp2 = [](double x) { return std::exp2(x); };
    // Compatible3dgs and Exact32 use degree 6, Tight and Balanced 5, Fast 4.
    add("exp2 degree 3", pass([](V x) { return Exp2Poly<3>()(x); }), exp2, powers, alpha);
    add("exp2 degree 4", pass([](V x) { return Exp2Poly<4>()(x); }), exp2, powers, alpha);
    add("exp2 degree 5", pass([](V x) { return Exp2Poly<5>()(x); }), exp2, powers, alpha);
    add("exp2 degree 6", pass([](V x) { return Exp2Poly<6>()(x); }), exp2, powers, alpha);
    add("exp2 of the lanes' library", pass([](V x) { return xsimd::exp2(x); }), exp2, powers,
        alpha);
    add("exp2 of libm, one by one", scalar_pass([](float x) { return std::exp2(x); }), exp2, powers,
        alpha);
    add(
        "exp of the lanes' library", pass([](V x) { return xsimd::exp(x); }),
        [](double x) { return std::exp(x); }, wide, near);
    add(
        "sigmoid", pass([](V x) { return sigmoid(x); }),
        [](double x) { return 1 / (1 + std::exp(-x)); }, wide, near);
    add(
        "softplus", pass([](V x) { return softplus(x); }),
        [](double x) { return std::max(x, 0.0) + std::log1p(std::exp(-std::abs(x))); }, wide, near);
    add(
        "sigmoid, one by one", scalar_pass([](float x) { return sigmoid(x); }),
        [](double x) { return 1 / (1 + std::exp(-x)); }, wide, near);
    add(
        "softplus, one by one", scalar_pass([](float x) { return softplus(x); }),
        [](double x) { return std::max(x, 0.0) + std::log1p(std::exp(-std::abs(x))); }, wide, near);
    add(
        "1 / sqrt", pass([](V x) { return V(1.0F) / sqrt(x); }),
        [](double x) { return 1 / std::sqrt(x); }, positive, some);
#ifndef __AVX512F__  // with AVX-512, xsimd 8.1 calls an instruction that does not exist
    add(
        "rsqrt of the lanes' library", pass([](V x) { return xsimd::rsqrt(x); }),
        [](double x) { return 1 / std::sqrt(x); }, positive, some);
#endif
    add(
        "sin of the lanes' library", pass([](V x) { return xsimd::sin(x); }),
        [](double x) { return std::sin(x); }, turns, near);
    add(
        "cos of the lanes' library", pass([](V x) { return xsimd::cos(x); }),
        [](double x) { return std::cos(x); }, turns, near);
    add(
        "sin of libm, one by one", scalar_pass([](float x) { return std::sin(x); }),
        [](double x) { return std::sin(x); }, turns, near);
    // Whole arrays, as in nn/encoding.hpp.
    const auto encode = [](auto&& f) {
        return [f](const float* x, float* y, std::size_t n) {
            const auto size = static_cast<Index>(n);
            f(Eigen::Map<const Eigen::ArrayXf>(x, size), Eigen::Map<Eigen::ArrayXf>(y, size));
        };
    };
    add(
        "sin of the encoding", encode([](const auto& x, auto y) { y = x.sin(); }),
        [](double x) { return std::sin(x); }, turns, near);
    add(
        "cos of the encoding", encode([](const auto& x, auto y) { y = x.cos(); }),
        [](double x) { return std::cos(x); }, turns, near);
    return rows;
}

} // namespace rye::bench
