// SPDX-License-Identifier: Apache-2.0
/// tests/support/layer_laws.hpp: laws of all lane code but splatting, for any width: masks and sums
/// of lanes, products and convolutions, networks, Adam, nearest landmarks, and the formulas of math
/// and rig with a point in each lane.
#pragma once

#include <cmath>
#include <vector>

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>
#include <rye/loss/dssim.hpp>
#include <rye/math/exponential.hpp>
#include <rye/math/harmonics.hpp>
#include <rye/nn/adam.hpp>
#include <rye/nn/convolution.hpp>
#include <rye/rig/influence.hpp>
#include <rye/rig/nearest_landmark.hpp>
#include <rye/splat/lanes/registers.hpp>

#include "lane_samples.hpp"
#include "laws.hpp"
#include "layer_reference.hpp"

namespace rye::test {

/// f of vectors of float and of double.
template <class B, class F>
void both_scalars(const F& f) {
    f.template operator()<typename B::template batch<float>>();
    f.template operator()<typename B::template batch<double>>();
}

TEST_CASE_TEMPLATE_DEFINE("widths: masks, sums and pairs of lanes", B, width_lanes) {
    both_scalars<B>([]<class V>() {
        using T = typename V::value_type;
        constexpr int lanes = int(V::size);
        alignas(64) T x[8 * lanes], y[8 * lanes];
        for (int shown = 0; shown < (1 << lanes); shown += 1 + shown / 7) {
            for (int i = 0; i < lanes; ++i) x[i] = (shown >> i & 1) != 0 ? T(i + 2) : T(-2);
            const V v = V::load_aligned(x);
            CHECK(detail::lane_bits(v > V(T(0))) == std::uint64_t(shown));
            where(v > V(T(0)), v).store_aligned(y);
            for (int i = 0; i < lanes; ++i) CHECK(y[i] == (x[i] > T(0) ? x[i] : T(0)));
        }
        std::array<V, 8> rows;
        T sums[9] = {};
        for (int k = 0; k < 8; ++k) {
            for (int i = 0; i < lanes; ++i) x[i] = T(k * lanes + i);
            rows[std::size_t(k)] = V::load_aligned(x);
        }
        detail::lane_sums(rows, sums + 1); // to any address
        for (int k = 0; k < 8; ++k) {
            CHECK(sums[1 + k] == T(k * lanes * lanes + lanes * (lanes - 1) / 2));
            CHECK(lane_sum(rows[std::size_t(k)]) == sums[1 + k]);
        }
        const T pair[3] = {T(0), T(1.5), T(-2.5)};
        if constexpr (LoadsPairs<V>) {
            repeat<2, V>(pair + 1).store_aligned(x);
            for (int i = 0; i < lanes; ++i) CHECK(x[i] == pair[1 + i % 2]);
        }
        repeat<1, V>(pair + 1).store_aligned(x);
        for (int i = 0; i < lanes; ++i) CHECK(x[i] == pair[1]);
    });
}

/// put(row, sum, before) = before - sum, inside larger matrices whose other numbers must stay.
template <class Left, class T>
double product_gap(Index rows, Index depth, Index columns) {
    const Columns<T> a = random_columns<T>(rows, depth, 1);
    const Columns<T> x = random_columns<T>(depth, columns, 2);
    const Columns<T> start = random_columns<T>(rows + 5, columns + 4, 3);
    Columns<double> expected = start.template cast<double>();
    for (Index j = 0; j < columns; ++j)
        for (Index k = 0; k < depth; ++k)
            for (Index i = 0; i < rows; ++i)
                expected(2 + i, 1 + j) -= double(a(i, k)) * double(x(k, j));
    double worst = 0;
    const auto put = [](Index, const auto& sum, const auto& before) {
        return std::remove_cvref_t<decltype(sum)>(before - sum);
    };
    const auto check = [&](const Columns<T>& y) {
        for (Index i = 0; i < y.size(); ++i)
            worst = std::max(worst, std::abs(double(y(i)) - expected(i)) / double(depth));
    };
    const Columns<T> turned = x.transpose(), turned_a = a.transpose();
    Left left;
    left.set(a);
    Columns<T> y = start;
    left.times(x, y.block(2, 1, rows, columns), put);
    check(y);
    y = start;
    left.times_transposed(turned, y.block(2, 1, rows, columns), put);
    check(y);
    left.set_transposed(turned_a);
    y = start;
    left.times(x, y.block(2, 1, rows, columns), put);
    check(y);
    Columns<T> sum = Columns<T>::Zero(rows, 1);
    left.set_and_sum(a, sum);
    for (Index i = 0; i < rows; ++i) {
        T s(0);
        for (Index k = 0; k < depth; ++k) s += a(i, k);
        worst = std::max(worst, std::abs(double(s - sum(i))) / double(depth));
    }
    return worst;
}

TEST_CASE_TEMPLATE_DEFINE("widths: products of matrices of every size", B, width_products) {
    using F = detail::LeftFactor<B, float>;
    using D = detail::LeftFactor<B, double>;
    for (const Index rows : {1, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 32, 33})
        for (const Index columns : {1, 2, 5, 6, 7, 12, 13}) {
            CAPTURE(rows);
            CAPTURE(columns);
            CHECK(product_gap<F, float>(rows, 5, columns) < 1e-6);
            CHECK(product_gap<D, double>(rows, 5, columns) < 1e-15);
        }
}

template <class B, class T>
double convolution_gap(int width, int height, int inputs, int outputs) {
    const Columns<T> w = random_columns<T>(outputs, 9 * inputs, 1);
    Image<T> in(width, height, inputs), g(width, height, outputs);
    in.pixels = random_columns<T>(inputs, in.size(), 2);
    g.pixels = random_columns<T>(outputs, g.size(), 3);
    Columns<double> y = Columns<double>::Zero(outputs, in.size());
    Columns<double> g_in = Columns<double>::Zero(inputs, in.size());
    Columns<double> g_w = Columns<double>::Zero(outputs, 9 * inputs);
    for (int k = 0; k < 9; ++k)
        for (int row = 0; row < height; ++row)
            for (int column = 0; column < width; ++column) {
                const int u = column + k % 3 - 1, v = row + k / 3 - 1;
                if (u < 0 || v < 0 || u >= width || v >= height) continue;
                const Index to = row * width + column, from = v * width + u;
                for (Index i = 0; i < inputs; ++i)
                    for (Index o = 0; o < outputs; ++o) {
                        const auto weight = double(w(o, k * inputs + i));
                        y(o, to) += weight * double(in.pixels(i, from));
                        g_in(i, from) += weight * double(g.pixels(o, to));
                        g_w(o, k * inputs + i) +=
                            double(g.pixels(o, to)) * double(in.pixels(i, from));
                    }
            }
    Columns<T> part = Columns<T>::Zero(outputs, 9 * inputs);
    convolve3x3_vjp_weight(B{}, padded(B{}, in), padded(B{}, g), part);
    const auto most = [](const Columns<T>& a, const Columns<double>& b) {
        return (a.template cast<double>() - b).cwiseAbs().maxCoeff();
    };
    return std::max({most(convolve3x3(B{}, w, padded(B{}, in)).pixels, y),
                     most(convolve3x3_vjp_input(B{}, w, g).pixels, g_in), most(part, g_w)});
}

TEST_CASE_TEMPLATE_DEFINE("widths: convolutions of every size and number of channels", B,
                          width_convolutions) {
    const int sizes[] = {1, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 32, 33};
    for (int i = 0; i < 13; ++i) {
        const int width = sizes[(i + 5) % 13], outputs = sizes[i], inputs = sizes[(i + 3) % 13];
        CAPTURE(width);
        CAPTURE(outputs);
        CHECK(convolution_gap<B, float>(width, 3, inputs, outputs) < 5e-5);
        CHECK(convolution_gap<B, double>(width, 2, inputs, outputs) < 1e-12);
    }
    CHECK(convolution_gap<B, float>(9, 3, 5, 32) < 5e-5);    // wide enough for lanes of any width
    CHECK(convolution_gap<B, float>(8, 3, 16, 16) < 5e-5);
    CHECK(convolution_gap<B, float>(17, 3, 3, 48) < 5e-5);
    CHECK(convolution_gap<B, double>(11, 3, 4, 24) < 1e-12);
    CHECK(convolution_gap<B, double>(40, 20, 16, 9) < 1e-12);  // several chunks
    CHECK(convolution_gap<B, float>(64, 3, 32, 16) < 1e-4);
    CHECK(convolution_gap<B, double>(1, 9, 1, 8) < 1e-12);
}

template <class T>
Columns<T> as(const Columns<double>& x) {
    return x.template cast<T>();
}

/// The gap of the dot-product test of a network, relative to the magnitudes of the terms.
template <class B, class T>
double mlp_gap(const MlpShape& shape, Index n) {
    const Probe<Mlp<double>> p{Mlp<double>::init(shape, Random{1, 0}),
                               Mlp<double>::init(shape, Random{2, 0}),
                               random_columns<double>(shape.point_inputs(), n, 3),
                               random_columns<double>(shape.point_inputs(), n, 4),
                               random_columns<double>(shape.outputs(), n, 5),
                               random_columns<double>(shape.frame_inputs, 1, 6),
                               random_columns<double>(shape.frame_inputs, 1, 7)};
    const Answer expected = answer(p);
    Mlp<T> m(shape), g(shape);
    convert_fields(m, p.network, [](double x) { return static_cast<T>(x); });
    const Columns<T> x = as<T>(p.in), w = as<T>(p.weights);
    const VecX<T> frame = p.frame.template cast<T>();
    MlpTrace<T> trace;
    const Columns<T> y = mlp_forward(B{}, m, x, frame, &trace);
    Columns<T> gx;
    VecX<T> g_frame;
    mlp_vjp(B{}, m, {x, frame, trace}, w, {g, &gx, &g_frame});
    CHECK((y.template cast<double>() - expected.out).cwiseAbs().maxCoeff() < 1e-5);
    DotProducts dots;
    dots.forward = expected.slope;
    dots.add_reverse(gx, p.d_in);
    dots.add_reverse(g_frame, p.d_frame);
    Mlp<double> wide(shape);
    convert_fields(wide, g, [](T v) { return static_cast<double>(v); });
    dots.add_reverse_fields(wide, p.d_network);
    return dots.error();
}

TEST_CASE_TEMPLATE_DEFINE("widths: networks, and their gradients against duals", B,
                          width_networks) {
    const MlpShape shapes[] = {{{12, 16, 24, 16, 5}, 7}, {{9, 17, 15, 33, 3}, 2}, {{6, 4}, 2},
                               {{7, 31, 1}, 0}, {{6, 8, 3}, 6}};
    for (const MlpShape& s : shapes)
        for (const Index n : {1, 17, 600}) {
            CAPTURE(n);
            CHECK(mlp_gap<B, double>(s, n) < 1e-13);
            CHECK(mlp_gap<B, float>(s, n) < 2e-5);
        }
}

/// The same for an upsampler.
template <class B, class T>
double upsampler_gap(const UpsamplerShape& shape) {
    Probe<Upsampler<double>> p{Upsampler<double>::init(shape, Random{1, 0}),
                               Upsampler<double>::init(shape, Random{2, 0}), {}, {}, {}, {}, {}};
    p.width = 9, p.height = 4;
    p.in = random_columns<double>(5, 36, 3), p.d_in = random_columns<double>(5, 36, 4);
    p.weights = random_columns<double>(3, Index(36) << (2 * shape.doublings), 5);
    if (shape.skip) {
        p.network.out_weight = random_columns<double>(3, shape.capacity, 6);
        p.in.topRows(3).array() += 0.6;                     // inside and outside of (0, 1)
    }
    const Answer expected = answer(p);
    Upsampler<T> u(shape), g(shape);
    convert_fields(u, p.network, [](double x) { return static_cast<T>(x); });
    Image<T> in(p.width, p.height, 5);
    in.pixels = as<T>(p.in);
    UpsamplerTrace<T> trace;
    const Image<T> y = upsampler_forward(B{}, u, in, &trace);
    Columns<T> g_in;
    upsampler_vjp(B{}, u, in, trace, as<T>(p.weights), g, &g_in);
    CHECK((y.pixels.template cast<double>() - expected.out).cwiseAbs().maxCoeff() <
          (sizeof(T) == 4 ? 1e-5 : 1e-12));
    DotProducts dots;
    dots.forward = expected.slope;
    dots.add_reverse(g_in, p.d_in);
    Upsampler<double> wide(shape);
    convert_fields(wide, g, [](T v) { return static_cast<double>(v); });
    dots.add_reverse_fields(wide, p.d_network);
    return dots.error();
}

TEST_CASE_TEMPLATE_DEFINE("widths: upsamplers, and their gradients against duals", B,
                          width_upsamplers) {
    for (const bool skip : {false, true}) {
        CAPTURE(skip);
        for (const int capacity : {3, 4, 8, 16})
            CHECK(upsampler_gap<B, double>({5, capacity, 1, Normalization::instance, skip}) <
                  1e-12);
        for (const Normalization norm : {Normalization::instance, Normalization::none})
            for (const int doublings : {0, 1, 2}) {
                CAPTURE(doublings);
                CHECK(upsampler_gap<B, double>({5, 4, doublings, norm, skip}) < 1e-12);
                CHECK(upsampler_gap<B, float>({5, 4, doublings, norm, skip}) < 1e-5);
            }
    }
}

template <class T>
struct OneField {
    Columns<T> a;

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        f("a", p.a...);
    }
};

TEST_CASE_TEMPLATE_DEFINE("widths: Adam moves every number of an array alike", B, width_adam) {
    for (const Index n : {1, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 32, 33}) {
        OneField<float> p{random_columns<float>(1, n, 1)};
        const OneField<float> before = p, g{random_columns<float>(1, n, 2)};
        Adam<OneField<float>> state(p);
        CHECK(adam_step(B{}, p, g, state, [](const std::string&) { return 1e-2; }).applied);
        for (Index i = 0; i < n; ++i)
            CHECK(p.a(i) - before.a(i) ==
                  doctest::Approx(g.a(i) > 0 ? -1e-2 : 1e-2).epsilon(1e-4));
        OneField<float> bad = g;
        bad.a(n - 1) = std::nanf("");
        CHECK(!adam_step(B{}, p, bad, state, [](const std::string&) { return 1e-2; }).applied);
    }
}

TEST_CASE_TEMPLATE_DEFINE("widths: DSSIM of every size is that of plain loops", B, width_dssim) {
    for (const int width : {1, 5, 8, 11, 16, 17, 33}) {
        Image<double> a(width, 9, 3), b(width, 9, 3);
        a.pixels = random_columns<double>(3, a.size(), 1).cwiseAbs();
        b.pixels = random_columns<double>(3, b.size(), 2).cwiseAbs();
        const auto lanes = dssim(B{}, a, b), plain = dssim(ScalarBackend<Serial>{}, a, b);
        CHECK(lanes.value == doctest::Approx(plain.value).epsilon(1e-13));
        CHECK((lanes.gradient - plain.gradient).cwiseAbs().maxCoeff() < 1e-13);
    }
}

TEST_CASE_TEMPLATE_DEFINE("widths: the nearest landmark, the lowest index of equals", B,
                          width_nearest) {
    const auto lattice = [](Index n, std::uint64_t seed) {   // exact distances, many ties
        Columns<float> x(3, n);
        for (Index i = 0; i < x.size(); ++i)
            x(i) = static_cast<float>(Random{seed}.below(static_cast<std::uint64_t>(i), 5));
        return x;
    };
    for (const Index n : {0, 1, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 32, 33, 65}) {
        const Columns<float> x = lattice(n, 1), p = lattice(40, 2);
        std::vector<Index> nearest;
        const Columns<float> d = nearest_squared_distance<float>(B{}, x, p, &nearest);
        for (Index i = 0; i < n; ++i) {
            Index best = 0;
            for (Index k = 1; k < p.cols(); ++k)
                if ((x.col(i) - p.col(k)).squaredNorm() < (x.col(i) - p.col(best)).squaredNorm())
                    best = k;
            CHECK(d(0, i) == (x.col(i) - p.col(best)).squaredNorm());
            CHECK(nearest[static_cast<std::size_t>(i)] == best);
        }
    }
}

TEST_CASE_TEMPLATE_DEFINE("widths: formulas of math and rig with a number in each lane", B,
                          width_formulas) {
    both_scalars<B>([]<class V>() {
        using T = typename V::value_type;
        const double u = std::is_same_v<T, float> ? 1 : 1e-8;     // of float's rounding
        const auto a = [](std::size_t l) { return unit_vec<T, 3>(l); };
        const auto b = [](std::size_t l) {                        // both sides of every branch
            return l == 0 ? Vec3<T>(-unit_vec<T, 3>(0))
                          : l == 1 ? unit_vec<T, 3>(1) : unit_vec<T, 3>(l, 2);
        };
        const auto w = [](std::size_t l) {
            return Vec3<T>(unit_vec<T, 3>(l) * (l == 0 ? T(0) : T(0.19) * T(l)));
        };
        const Vec3<V> av = lanes_of<V, 3>(a), bv = lanes_of<V, 3>(b), wv = lanes_of<V, 3>(w);
        CHECK(lane_gap(shortest_arc(av, bv),
                       [&](std::size_t l) { return shortest_arc(a(l), b(l)); }) <= 4e-7 * u);
        CHECK(lane_gap(so3_exp_quat(wv), [&](std::size_t l) { return so3_exp_quat(w(l)); }) <=
              4e-7 * u);
        CHECK(lane_gap(quat_log(so3_exp_quat(wv)), [&](std::size_t l) {
                  return quat_log(so3_exp_quat(w(l)));
              }) <= 1e-6 * u);
        CHECK(lane_gap(matrix_quat(so3_exp(wv)), [&](std::size_t l) {
                  return matrix_quat(so3_exp(w(l)));
              }) <= 6e-7 * u);
        const ShArray<V, 4> basis = sh_basis<V, 4>(av);
        const Ramp<V> ramp{V(T(0.15)), V(T(0.25))};
        const Ramp<T> one{T(0.15), T(0.25)};
        for (std::size_t l = 0; l < V::size; ++l) {
            const auto expected = sh_basis<T, 4>(a(l));
            for (std::size_t k = 0; k < 25; ++k)
                CHECK(std::abs(double(basis[k].get(l) - expected[k])) <= 2e-6 * u);
            for (T x = T(-30); x < T(30); x += T(3.7)) {
                CHECK(std::abs(double(sigmoid(V(x)).get(l) - sigmoid(x))) <= 2e-7 * u);
                CHECK(std::abs(double(softplus(V(x)).get(l) - softplus(x))) <=
                      4e-7 * u * double(1 + softplus(x)));
                CHECK(std::abs(double(Exp2Poly<5>()(V(x)).get(l) / Exp2Poly<5>()(x)) - 1) <=
                      2.4e-7 * u);
            }
            for (T s = 0; s < T(0.3); s += T(0.013)) {
                CHECK(influence(SquaredDistance{}, ramp, V(s)).get(l) ==
                      doctest::Approx(influence(SquaredDistance{}, one, s)));
                CHECK(detail::influence_slope(EuclideanDistance{}, ramp, V(s)).get(l) ==
                      doctest::Approx(detail::influence_slope(EuclideanDistance{}, one, s)));
            }
        }
    });
}

/// The laws of layers, of which plain loops are one way, for each backend of a list.
#define RYE_LAYER_LAWS(...)                                                                        \
    TEST_CASE_TEMPLATE_APPLY(width_convolutions, __VA_ARGS__);                                     \
    TEST_CASE_TEMPLATE_APPLY(width_networks, __VA_ARGS__);                                         \
    TEST_CASE_TEMPLATE_APPLY(width_upsamplers, __VA_ARGS__);                                       \
    TEST_CASE_TEMPLATE_APPLY(width_adam, __VA_ARGS__);                                             \
    TEST_CASE_TEMPLATE_APPLY(width_dssim, __VA_ARGS__);                                            \
    TEST_CASE_TEMPLATE_APPLY(width_nearest, __VA_ARGS__)

/// The laws of lanes themselves, for each backend of a list.
#define RYE_LANE_LAWS(...)                                                                         \
    TEST_CASE_TEMPLATE_APPLY(width_lanes, __VA_ARGS__);                                            \
    TEST_CASE_TEMPLATE_APPLY(width_products, __VA_ARGS__);                                         \
    TEST_CASE_TEMPLATE_APPLY(width_formulas, __VA_ARGS__)

} // namespace rye::test
