// SPDX-License-Identifier: Apache-2.0
#include <rye/rig/lid_shadow.hpp>

#include <cmath>
#include <limits>
#include <vector>

#include <doctest/doctest.h>

#include <rye/autodiff/dual.hpp>
#include <rye/core/random.hpp>

using namespace rye;

namespace {

using V = Vec3<double>;
using Points = std::vector<double>; // x and y of each

constexpr double infinity = std::numeric_limits<double>::infinity();

/// A lid's arc above an open eye.
Points arc(double height = 0.4, int count = 9) {
    Points at;
    for (int k = 0; k < count; ++k) {
        const double x = -1 + 2.0 * k / (count - 1);
        at.insert(at.end(), {x, height - 0.5 * x * x});
    }
    return at;
}

template <class T>
LidOfEye<T> lid_of(const std::vector<T>& at, const T* numbers, const Mat3<T>& turn,
                   const T& radius) {
    LidOfEye<T> lid;
    const detail::LidArc<T> points{at.data(), static_cast<Index>(at.size() / 2)};
    for (int node = 0; node < lid_nodes; ++node)
        lid.height[std::size_t(node)] = points.mean(node).height;
    set_lid_turn(turn, radius, lid);
    set_lid_numbers(numbers, lid);
    return lid;
}
LidOfEye<double> lid_of(const Points& at, const std::array<double, 3>& numbers) {
    return lid_of<double>(at, numbers.data(), Mat3<double>::Identity(), 1);
}
double factor(const LidOfEye<double>& lid, double x, double y) {
    return LidShade<double>(lid, V(x, y, 0.5)).factor;
}

} // namespace

TEST_CASE(
    "lid shadow: dark above the line, by 1 - a exp(-t^2 / (1 + t)) below, with a steady slope") {
    const LidOfEye<double> lid = lid_of({-1, 0.3, 0, 0.3, 1, 0.3}, {0.5, std::log(0.2), 0.05});
    const double a = 1 / (1 + std::exp(-0.5));
    for (const double x : {-0.8, -0.1, 0.0, 0.77}) {
        CHECK(factor(lid, x, 0.36) == doctest::Approx(1 - a).epsilon(1e-14));
        CHECK(factor(lid, x, 0.9) == doctest::Approx(1 - a).epsilon(1e-14));
        for (const double d : {0.01, 0.1, 0.4, 1.2}) {
            const double t = d / 0.2;
            CHECK(factor(lid, x, 0.35 - d) ==
                  doctest::Approx(1 - a * std::exp(-t * t / (1 + t))).epsilon(1e-12));
        }
        for (const double h : {1e-3, 1e-4}) // the slope on the line is 0 from both sides
            CHECK(std::abs(factor(lid, x, 0.35 - h) - factor(lid, x, 0.35 + h)) <
                  1.1 * a * h * h / 0.04);
    }
    CHECK(factor(lid, 0, -5) > 1 - 1e-10);
}

TEST_CASE("lid shadow: the line goes along its points, and its slope has no steps") {
    const LidOfEye<double> lid = lid_of(arc(0.4, 33), {0, -1, 0});
    const auto line = [&](double x) { // where the shadow is half of what it is above
        const detail::LidPlace<double> at(x);
        double y = 0, sum = 0;
        for (int k = 0; k < 3; ++k) {
            y += at.weight[k] * lid.height[std::size_t(at.first + k)];
            sum += at.weight[k];
            CHECK(at.first >= 0);
            CHECK(at.first + 2 < lid_nodes);
        }
        CHECK(sum == doctest::Approx(1).epsilon(1e-14));
        return y;
    };
    for (double x = -0.85; x < 0.85; x += 0.01) {
        CHECK(line(x) == doctest::Approx(0.4 - 0.5 * x * x).epsilon(0.06));
        const double h = 1e-5;
        CHECK(std::abs(line(x + h) - 2 * line(x) + line(x - h)) < 2 * 1.5 * h * h + 1e-14);
    }
    CHECK(line(-3) == line(-1));
    CHECK(line(7) == line(1));
}

TEST_CASE("lid shadow: the cotangents are the transpose of the duals") {
    using D = Dual<double, 1>;
    const Random random{3, 1};
    std::uint64_t next = 0;
    const auto any = [&] { return 2 * random.uniform(next++) - 1; };
    double most = 0;
    for (int trial = 0; trial < 200; ++trial) {
        Points at = arc(0.3 + 0.3 * any());
        for (double& x : at) x += 0.1 * any();
        std::array<double, 3> numbers{any(), -1 + any(), 0.1 * any()};
        Mat3<double> turn;
        for (Index i = 0; i < 9; ++i) turn(i) = any();
        const V point(0.4 * any(), 0.4 * any(), 0.5);
        std::vector<D> d_at(at.size());
        std::array<D, 3> d_numbers;
        Mat3<D> d_turn;
        Points v_at(at.size());
        std::array<double, 3> v_numbers{};
        Mat3<double> v_turn;
        const auto seed = [&](double x, double& v) {
            v = any();
            D d(x);
            d.d[0] = v;
            return d;
        };
        for (std::size_t k = 0; k < at.size(); ++k) d_at[k] = seed(at[k], v_at[k]);
        for (std::size_t k = 0; k < 3; ++k) d_numbers[k] = seed(numbers[k], v_numbers[k]);
        for (Index i = 0; i < 9; ++i) d_turn(i) = seed(turn(i), v_turn(i));
        const LidOfEye<D> d_lid = lid_of<D>(d_at, d_numbers.data(), d_turn, D(1.3));
        const double forward = LidShade<D>(d_lid, point.cast<D>()).factor.d[0];

        const LidOfEye<double> lid = lid_of<double>(at, numbers.data(), turn, 1.3);
        Array<double, std::size_t(LidSums::count)> sums{};
        lid_shade_vjp(lid, point, LidShade<double>(lid, point), 1.0, sums);
        Points g_at(at.size(), 0);
        std::array<double, 3> g_numbers{};
        const detail::LidArc<double> points{at.data(), static_cast<Index>(at.size() / 2)};
        for (Index k = 0; k < points.count; ++k)
            points.vjp(k, sums.begin() + LidSums::height_at, &g_at[std::size_t(2 * k)]);
        lid_numbers_vjp(numbers.data(), sums, g_numbers.data());
        const Mat3<double> g_turn = lid_turn_vjp(sums, 1.3);
        double reverse = 0;
        for (std::size_t k = 0; k < at.size(); ++k) reverse += g_at[k] * v_at[k];
        for (std::size_t k = 0; k < 3; ++k) reverse += g_numbers[k] * v_numbers[k];
        for (Index i = 0; i < 9; ++i) reverse += g_turn(i) * v_turn(i);
        CHECK(std::abs(forward - reverse) < 1e-12);
        most = std::max(most, std::abs(forward));
    }
    CHECK(most > 0.1);
}

TEST_CASE("lid shadow: hard cases stay finite, and take no more than the share a") {
    const auto check = [](const Points& at, const std::array<double, 3>& numbers) {
        const auto finite = []<class T>(const std::vector<T>& from, const std::array<T, 3>& n) {
            LidOfEye<T> lid = lid_of<T>(from, n.data(), Mat3<T>::Identity(), T(1));
            for (const double y : {-1e30, -2.0, 0.0, 0.3, 0.30001, 1e30})
                for (const double x : {-1e30, -1.0, 0.0, 1.0, 1e30}) {
                    const Vec3<T> p{T(x), T(y), T(0)};
                    const LidShade<T> at_p(lid, p);
                    CHECK(at_p.factor <= 1);
                    CHECK(at_p.factor >= 1 - lid.strength);
                    Array<T, std::size_t(LidSums::count)> sums{};
                    lid_shade_vjp(lid, p, at_p, T(1), sums);
                    std::vector<T> g(from.size(), T(0));
                    const detail::LidArc<T> points{from.data(),
                                                   static_cast<Index>(from.size() / 2)};
                    for (Index k = 0; k < points.count; ++k)
                        points.vjp(k, sums.begin() + LidSums::height_at, &g[std::size_t(2 * k)]);
                    for (const T v : g) CHECK(std::isfinite(v));
                    for (const T v : sums) CHECK(!std::isnan(v));
                }
        };
        finite(at, numbers);
        std::vector<float> single(at.begin(), at.end());
        finite(single, {float(numbers[0]), float(numbers[1]), float(numbers[2])});
    };
    const Points open = arc(), closed = arc(-0.6), one{0.0, 0.3},
                 same{0.1, 0.3, 0.1, 0.3, 0.1, 0.3}, far{1e20, 0.1, -1e20, 0.2, 3, 1e15};
    for (const Points& at : {open, closed, one, same, far})
        for (const double strength : {-infinity, -800.0, 0.0, 800.0, infinity})
            for (const double width : {-1e9, -7.0, -1.0, 1e9})
                for (const double offset : {0.0, -1e15, 1e15}) check(at, {strength, width, offset});
}

TEST_CASE("lid shadow: a closed lid darkens all of the eye alike, and none changes no bit") {
    const LidOfEye<double> closed = lid_of(arc(-0.7), {1.0, -1.5, 0.0});
    const double dark = 1 - closed.strength;
    for (const double y : {-0.1, 0.2, 0.9}) CHECK(factor(closed, 0.1, y) == dark);
    const LidOfEye<double> off = lid_of(arc(), {-infinity, -1.5, 0.0});
    for (const double y : {-0.9, 0.2, 0.9}) CHECK(factor(off, 0.1, y) == 1);
}
