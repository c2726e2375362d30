// SPDX-License-Identifier: Apache-2.0
#include <rye/nn/product.hpp>

#include <cmath>

#include <doctest/doctest.h>

#include <rye/backend/lanes.hpp>
#include <rye/backend/scalar.hpp>

#include "../support/laws.hpp"

using namespace rye;

namespace {

/// A x and A x^T against Eigen's in double, inside larger matrices whose other numbers must stay.
template <class B, class T>
double product_error(Index rows, Index depth, Index columns, std::uint64_t seed) {
    const Columns<T> a = random_columns<T>(rows, depth, seed);
    const Columns<T> x = random_columns<T>(depth + 3, columns + 2, seed + 1);
    const Columns<T> start = random_columns<T>(rows + 5, columns + 4, seed + 2);
    const ColumnsView<T> view = x.block(1, 1, depth, columns);
    const Columns<double> expected = a.template cast<double>() * view.template cast<double>();

    double worst = 0;
    const auto check = [&](const detail::LeftFactor<B, T>& left, const ColumnsView<T>& right,
                           bool turned) {
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
    detail::LeftFactor<B, T> left;
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

/// A library's product as a user would link it: called by many threads, with leading dimensions.
struct Loops {
    template <class T>
    static void multiply(const StridedMatrix<const T>& a, const StridedMatrix<const T>& x,
                         bool x_transposed, const StridedMatrix<T>& y) {
        for (Index j = 0; j < y.cols; ++j)
            for (Index i = 0; i < y.rows; ++i) {
                T sum(0);
                for (Index l = 0; l < a.cols; ++l)
                    sum += a.data[i + l * a.stride] *
                           x.data[x_transposed ? j + l * x.stride : l + j * x.stride];
                y.data[i + j * y.stride] = sum;
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

} // namespace

TEST_CASE("product: policies that a backend names give the same numbers") {
    CHECK(worst_product<EigenInLanes, float>(4) <= 1e-6);
    CHECK(worst_product<EigenInLanes, double>(5) <= 1e-15);
    CHECK(worst_product<LibraryInLanes, float>(6) <= 1e-6);
    CHECK(worst_product<LibraryInLanes, double>(7) <= 1e-15);
    CHECK(worst_product<LibraryAlone, float>(8) <= 1e-6);
}

TEST_CASE("product: a column's bits do not depend on its neighbours") {
    using B = XsimdBackend<>;
    const Columns<float> a = random_columns<float>(21, 33, 1), x = random_columns<float>(33, 29, 2);
    detail::LeftFactor<B, float> left;
    left.set(a);
    const auto put = [](Index, const auto& sum, const auto&) { return sum; };
    Columns<float> all = Columns<float>::Zero(21, 29), alone = all;
    left.times(x, all, put);
    for (Index j = 0; j < x.cols(); ++j) left.times(x.middleCols(j, 1), alone.middleCols(j, 1), put);
    CHECK(all == alone);
}

TEST_CASE("product: rows tell where a sum stands") {
    using B = XsimdBackend<>;
    detail::LeftFactor<B, double> left;
    left.set(Columns<double>::Zero(19, 2));
    const VecX<double> bias = VecX<double>::LinSpaced(64, 0, 63);
    Columns<double> y = Columns<double>::Zero(19, 7);
    left.times(Columns<double>::Zero(2, 7), y, [&](Index row, const auto& sum, const auto&) {
        return std::remove_cvref_t<decltype(sum)>(sum + load_like(sum, bias.data() + row));
    });
    for (Index j = 0; j < 7; ++j) CHECK(y.col(j) == bias.head(19));
}
