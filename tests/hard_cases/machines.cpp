// SPDX-License-Identifier: Apache-2.0
// Effects of compilers, processors and locales on numbers (I1-I3, I8, I10-I12).
#include <clocale>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <memory>

#include <rye/io/json.hpp>
#include <rye/math/linalg.hpp>
#include <rye/math/rotation.hpp>
#include <rye/nn/elementwise.hpp>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "report.hpp"

namespace rye::hard {
namespace {

template <class S>
void i1(Report& report) {
    using R = real_t<S>;
    // The determinant of two equal rows: exactly d (2 |x|^2) + d^2, never below, fused or not.
    bool sound = true;
    Index negative = 0;
    for (std::uint64_t i = 0; i < 100000; ++i) {
        const R x = static_cast<R>(Random{1, 0}.normal(2 * i)),
                y = static_cast<R>(Random{1, 2}.normal(2 * i));
        const Vec3<S> row = {S(x), S(y), S(R(0))};
        sound = sound && first(detail::gram_determinant(row, row, S(R(0)))) >= 0;
        if (std::fma(x, x, -(x * x)) < 0) ++negative;
    }
    report.holds("I1", kind_of<S>(), "100000 pairs of equal rows: determinant >= 0", sound);
    report.textbook("I1", kind_of<S>(), "x x - x x with a fused product: share below 0", 0,
                    double(negative) / 1e5);
}

void i2(Report& report) {
#if defined(__FAST_MATH__)
    const bool strict = false;
#else
    const bool strict = true;
#endif
    report.holds("I2", "compiler", "this program is not built with -ffast-math, which is an #error",
                 strict && std::isnan(std::numeric_limits<double>::quiet_NaN()));
}

/// Values with denormals flushed to zero and without.
template <class S>
void i3(Report& report) {
#if defined(__x86_64__)
    using R = real_t<S>;
    const unsigned before = _mm_getcsr();
    double worst = 0;
    bool finite = true;
    for (const double size : {1e-45, 1e-38, 1e-20, 1.0, 1e20}) {
        double value[2];
        for (int flush = 0; flush < 2; ++flush) {
            _mm_setcsr(flush == 1 ? before | 0x8040U : before & ~0x8040U);
            volatile R s = static_cast<R>(size);
            const Quat<S> q = quat_normalized(Quat<S>(S(R(s)), S(R(s) / 2), S(R(0)), S(R(s))));
            value[flush] = first(q[0]);
            finite = finite && std::isfinite(value[flush]);
        }
        _mm_setcsr(before);
        // Below the least normal number the flushed quaternion is the zero one: the identity.
        if (size >= 1e-37) worsen(worst, std::abs(value[0] - value[1]));
    }
    report.at_most("I3", kind_of<S>(), "normalise with and without flush to zero: difference",
                   1e-38, worst);
    report.holds("I3", kind_of<S>(), "denormals: finite both ways", finite);
#else
    report.holds("I3", kind_of<S>(), "no flush mode on this processor", true);
#endif
}

/// Sizes around a vector's, between guards that must stay unchanged.
template <class T>
void i8(Report& report) {
    constexpr Index lanes = static_cast<Index>(Lanes<T>::size);
    bool same = true, guarded = true;
    for (Index n = 0; n <= 4 * lanes + 3; ++n) {
        std::vector<T> in(static_cast<std::size_t>(n)), out(static_cast<std::size_t>(n) + 8, T(-7));
        for (Index i = 0; i < n; ++i) in[static_cast<std::size_t>(i)] = static_cast<T>(i) - T(3);
        detail::transform_array<XsimdBackend<>>(
            n, out.data(), [](auto x) { return leaky_relu(x); }, in.data());
        for (std::size_t i = 0; i < in.size(); ++i) same = same && out[i] == leaky_relu(in[i]);
        for (std::size_t i = in.size(); i < out.size(); ++i) guarded = guarded && out[i] == T(-7);
    }
    report.holds("I8", kind_of<T>(), "sizes 0 to 4 W + 3: same numbers, guards untouched",
                 same && guarded);
}

void i10_i11(Report& report) {
    const std::string before = std::setlocale(LC_ALL, nullptr);
    const bool comma = std::setlocale(LC_ALL, "de_DE.UTF-8") != nullptr;
    const JsonValue v = parse_json("[0.5, 1.25e-3]", "x.json");
    const auto& a = *v.get<JsonArray>();
    const bool same = *a[0].get<double>() == 0.5 && *a[1].get<double>() == 1.25e-3;
    const double textbook = std::strtod("0.5", nullptr);
    std::setlocale(LC_ALL, before.c_str());
    report.holds("I10", comma ? "de_DE" : "C (de_DE is not installed)", "JSON numbers", same);
    if (comma) report.textbook_fails("I10", "de_DE", "strtod of 0.5", textbook == 0.5);
    Index lost = 0, short_lost = 0;
    for (std::uint64_t i = 0; i < 200000; ++i) {
        const float f = std::bit_cast<float>(static_cast<std::uint32_t>(Random{11, 0}.bits(i)));
        if (!std::isfinite(f)) continue;
        char text[32];
        std::snprintf(text, sizeof text, "%.9g", static_cast<double>(f));
        const JsonValue back = parse_json("[" + std::string(text) + "]", "x.json");
        const JsonValue& n = back.get<JsonArray>()->front();
        const double d = n.get<double>() != nullptr ? *n.get<double>()
                                                    : static_cast<double>(*n.get<std::int64_t>());
        if (std::bit_cast<std::uint32_t>(static_cast<float>(d)) !=
                std::bit_cast<std::uint32_t>(f) &&
            f != 0.0F)
            ++lost;
        std::snprintf(text, sizeof text, "%.6g", static_cast<double>(f));
        if (std::strtof(text, nullptr) != f) ++short_lost;
    }
    report.at_most("I11", "float", "200000 random bits through JSON with 9 digits: lost", 0,
                   double(lost));
    report.textbook("I11", "float", "6 digits: lost", 0, double(short_lost));
}

} // namespace

void machines(Report& report) {
    every_scalar([&]<class S>() {
        i1<S>(report);
        i3<S>(report);
    });
    i2(report);
    i8<float>(report);
    i8<double>(report);
    i10_i11(report);
}

} // namespace rye::hard
