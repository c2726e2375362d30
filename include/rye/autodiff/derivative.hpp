// SPDX-License-Identifier: Apache-2.0
/// rye/autodiff/derivative.hpp: derivatives of functions that are templates over their scalar, one
/// evaluation on duals each. Functions of arrays take and return Columns<Dual<T, 1>>.
#pragma once

#include <rye/autodiff/dual.hpp>
#include <rye/core/columns.hpp>

namespace rye {

namespace detail {

/// Returns x + dx e, entry by entry; both of one shape.
template <class X, class D>
Columns<Dual<typename X::Scalar, 1>> seeded(const Eigen::MatrixBase<X>& x,
                                            const Eigen::MatrixBase<D>& dx) {
    RYE_ASSERT(x.rows() == dx.rows() && x.cols() == dx.cols(), "seeded: x and dx differ in shape");
    Columns<Dual<typename X::Scalar, 1>> r(x.rows(), x.cols());
    for (Index j = 0; j < x.cols(); ++j)
        for (Index i = 0; i < x.rows(); ++i) {
            r(i, j).value = x(i, j);
            r(i, j).d[0] = dx(i, j);
        }
    return r;
}

} // namespace detail

/// Returns the values of an array of duals.
template <Scalar T, int N, class Tag>
Columns<T> values_of(const Columns<Dual<T, N, Tag>>& x) {
    Columns<T> r(x.rows(), x.cols());
    for (Index i = 0; i < x.size(); ++i) r.data()[i] = x.data()[i].value;
    return r;
}

/// Returns the derivatives of an array of duals in direction k, 0 to N - 1.
template <Scalar T, int N, class Tag>
Columns<T> tangents_of(const Columns<Dual<T, N, Tag>>& x, std::size_t k = 0) {
    Columns<T> r(x.rows(), x.cols());
    for (Index i = 0; i < x.size(); ++i) r.data()[i] = x.data()[i].d[k];
    return r;
}

/// Returns f'(x) of a scalar function. T may itself be a dual (second derivatives).
template <Scalar T, class F>
T derivative(F&& f, const T& x) {
    return Dual<T, 1>(f(Dual<T, 1>::variable(x))).d[0];
}

/// Returns J dx, in the shape of f(x).
template <class F, class X, class D>
Columns<typename X::Scalar> jvp(F&& f, const Eigen::MatrixBase<X>& x,
                                const Eigen::MatrixBase<D>& dx) {
    const Columns<Dual<typename X::Scalar, 1>> y = f(detail::seeded(x, dx));
    return tangents_of(y);
}

/// Returns J, a row per entry of f(x) and a column per entry of x, both in column-major order.
template <class F, class X>
Columns<typename X::Scalar> jacobian(F&& f, const Eigen::MatrixBase<X>& x) {
    using T = typename X::Scalar;
    Columns<T> dx = Columns<T>::Zero(x.rows(), x.cols()), j;
    for (Index k = 0; k < x.size(); ++k) {
        dx.data()[k] = T(1);
        const Columns<T> column = jvp(f, x, dx);
        if (k == 0) j.resize(column.size(), x.size());
        j.col(k) = column.reshaped();
        dx.data()[k] = T(0);
    }
    return j;
}

} // namespace rye
