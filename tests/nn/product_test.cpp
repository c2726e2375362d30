// SPDX-License-Identifier: Apache-2.0
#include <rye/nn/product_bf16.hpp>

#include <bit>
#include <cmath>
#include <limits>

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>
#include <rye/backend/lanes.hpp>

#include "adjoint.hpp"

using namespace rye;

namespace {

/// A x and A x^T against Eigen's in double, inside larger matrices whose other numbers stay.
template <class B, class T>
double product_error(Index rows, Index depth, Index columns, std::uint64_t seed) {
    const Columns<T> a = random_columns<T>(rows, depth, seed);
    const Columns<T> x = random_columns<T>(depth + 3, columns + 2, seed + 1);
    const Columns<T> start = random_columns<T>(rows + 5, columns + 4, seed + 2);
    const ColumnsView<T> view = x.block(1, 1, depth, columns);
    const Columns<double> expected = a.template cast<double>() * view.template cast<double>();

    double worst = 0;
    const auto check = [&](const LeftFactor<B, T>& left, const ColumnsView<T>& right, bool turned) {
        Columns<T> y = start;
        const auto put = [](Index, const auto& sum, const auto& before) { return before - sum; };
        if (turned)
            left.times_transposed(right, y.block(2, 1, rows, columns), put);
        else
            left.times(right, y.block(2, 1, rows, columns), put);
        Columns<double> wanted = start.template cast<double>();
        wanted.block(2, 1, rows, columns) -= expected;
        const Columns<double> off = y.template cast<double>() - wanted;
        worst = std::max(worst, off.cwiseAbs().maxCoeff() / double(depth));
        y.block(2, 1, rows, columns) = start.block(2, 1, rows, columns);
        CHECK(y == start);
    };
    LeftFactor<B, T> left;
    left.set(a);
    check(left, view, false);
    const Columns<T> turned_x = view.transpose();
    check(left, turned_x, true);
    left.set_transposed(Columns<T>(a.transpose()));
    check(left, view, false);
    return worst;
}

template <class B, class T>
double worst_product(std::uint64_t seed) {
    double worst = 0;
    for (const Index rows : {1, 3, 8, 9, 16, 17, 25, 64})
        for (const Index depth : {1, 5, 64})
            for (const Index columns : {1, 2, 5, 6, 7, 13, 40})
                worst = std::max(worst, product_error<B, T>(rows, depth, columns, ++seed));
    return worst;
}

} // namespace

TEST_CASE("product: equals the matrix product, for sizes around those of panels and tiles") {
    CHECK(worst_product<XsimdBackend<>, float>(1) <= 1e-6);
    CHECK(worst_product<XsimdBackend<>, double>(2) <= 1e-15);
    CHECK(worst_product<ScalarBackend<>, float>(3) <= 1e-6);
}

namespace {

/// A library's product as a user links it: called by many threads, with leading dimensions.
struct Loops {
    template <class T>
    static void multiply(bool x_transposed, Index m, Index n, Index k, const T* a, Index lda,
                         const T* x, Index ldx, T* y, Index ldy) {
        for (Index j = 0; j < n; ++j)
            for (Index i = 0; i < m; ++i) {
                T sum(0);
                for (Index l = 0; l < k; ++l)
                    sum += a[i + l * lda] * (x_transposed ? x[j + l * ldx] : x[l + j * ldx]);
                y[i + j * ldy] = sum;
            }
    }
};

struct EigenInLanes : XsimdBackend<> {
    using products = EigenProducts;
};
struct LibraryInLanes : XsimdBackend<> {
    using products = GemmProducts<Loops>;
};
struct LibraryAlone : ScalarBackend<> {
    using products = GemmProducts<Loops>;
};
struct Rounded : XsimdBackend<> {
    using products = Bf16Products;
};

} // namespace

TEST_CASE("product: policies that a backend names give the same numbers") {
    CHECK(worst_product<EigenInLanes, float>(4) <= 1e-6);
    CHECK(worst_product<EigenInLanes, double>(5) <= 1e-15);
    CHECK(worst_product<LibraryInLanes, float>(6) <= 1e-6);
    CHECK(worst_product<LibraryInLanes, double>(7) <= 1e-15);
    CHECK(worst_product<LibraryAlone, float>(8) <= 1e-6);
}

TEST_CASE("product: factors rounded to bfloat16 are nearest, and NaN and infinity stay") {
    CHECK(Bf16Pair::of(1.00390625F, -1.01171875F).first() == 1.F);   // half way: to even
    CHECK(Bf16Pair::of(1.00390625F, -1.01171875F).second() == -1.015625F);
    CHECK(Bf16Pair::of(1.004F, 0.F).first() == 1.0078125F);
    CHECK(Bf16Pair::of(3.4e38F, 0.F).first() == std::numeric_limits<float>::infinity());
    CHECK(Bf16Pair::of(-0.F, 0.F).bits == 0x8000U);
    const float inf = std::numeric_limits<float>::infinity();
    CHECK(Bf16Pair::of(inf, -inf).first() == inf);
    CHECK(Bf16Pair::of(inf, -inf).second() == -inf);
    for (const std::uint32_t nan : {0x7f800001U, 0x7fc00000U, 0x7fffffffU, 0xffffffffU}) {
        CHECK(std::isnan(Bf16Pair::of(std::bit_cast<float>(nan), 0.F).first()));
        CHECK(std::isnan(Bf16Pair::of(0.F, std::bit_cast<float>(nan)).second()));
    }
}

TEST_CASE("product: rounded factors are multiplied exactly and summed in float") {
    const auto rounded = [](Columns<float> x) {
        for (Index i = 0; i < x.size(); ++i) x(i) = Bf16Pair::of(x(i), 0.F).first();
        return x;
    };
    double worst = 0, unrounded = 0;
    for (const Index rows : {1, 8, 19, 33})
        for (const Index depth : {1, 2, 7, 64}) {
            const Columns<float> a = random_columns<float>(rows, depth, 1);
            const Columns<float> x = random_columns<float>(depth, 13, 2);
            const Columns<double> expected =
                rounded(a).cast<double>() * rounded(x).cast<double>();
            LeftFactor<Rounded, float> left;
            left.set(a);
            Columns<float> y = Columns<float>::Zero(rows, 13);
            left.times(x, y, [](Index, const auto& sum, const auto&) { return sum; });
            worst = std::max(worst, (y.cast<double>() - expected).cwiseAbs().maxCoeff() /
                                        double(depth));
            unrounded = std::max(
                unrounded, (y - a * x).cwiseAbs().maxCoeff() / double(depth));
        }
    CHECK(worst <= 1e-6);
    CHECK(unrounded >= 1e-4); // it does round
    CHECK(worst_product<Rounded, float>(9) <= 8e-3);
}

TEST_CASE("product: a column's bits do not depend on its neighbours") {
    using B = XsimdBackend<>;
    const Columns<float> a = random_columns<float>(21, 33, 1), x = random_columns<float>(33, 29, 2);
    LeftFactor<B, float> left;
    left.set(a);
    const auto put = [](Index, const auto& sum, const auto&) { return sum; };
    Columns<float> all = Columns<float>::Zero(21, 29), alone = all;
    left.times(x, all, put);
    for (Index j = 0; j < x.cols(); ++j) left.times(x.middleCols(j, 1), alone.middleCols(j, 1), put);
    CHECK(all == alone);
}

TEST_CASE("product: rows tell where a sum stands") {
    using B = XsimdBackend<>;
    LeftFactor<B, double> left;
    left.set(Columns<double>::Zero(19, 2));
    const VecX<double> bias = VecX<double>::LinSpaced(64, 0, 63);
    Columns<double> y = Columns<double>::Zero(19, 7);
    left.times(Columns<double>::Zero(2, 7), y, [&](Index row, const auto& sum, const auto&) {
        return std::remove_cvref_t<decltype(sum)>(sum + load_like(sum, bias.data() + row));
    });
    for (Index j = 0; j < 7; ++j) CHECK(y.col(j) == bias.head(19));
}
