// SPDX-License-Identifier: Apache-2.0
/// tests/support/laws.hpp: duals of arrays, and the dot-product test over them.
#pragma once

#include <cmath>

#include <rye/autodiff/dual.hpp>
#include <rye/core/fields.hpp>

#include "random.hpp"

namespace rye {

/// a + da e.
template <class T>
Columns<Dual<T, 1>> lifted(const Columns<T>& a, const Columns<T>& da) {
    return a.binaryExpr(da, [](T x, T dx) {
        Dual<T, 1> d(x);
        d.d[0] = dx;
        return d;
    });
}
template <class T>
Columns<T> values(const Columns<Dual<T, 1>>& a) {
    return a.unaryExpr([](const Dual<T, 1>& x) { return x.value; });
}
template <class T>
Columns<T> tangents(const Columns<Dual<T, 1>>& a) {
    return a.unaryExpr([](const Dual<T, 1>& x) { return x.d[0]; });
}
template <class D, class P>
void lift_fields(D& out, const P& p, const P& dp) {
    D::fields([](const std::string&, auto& d, const auto& a, const auto& da) { d = lifted(a, da); },
              out, p, dp);
}

/// <J v, w> and <v, J^T w>, and the sum of the magnitudes of their terms.
struct DotProducts {
    double forward = 0, reverse = 0, terms = 0;

    template <class A, class B>
    void add_forward(const Eigen::MatrixBase<A>& a, const Eigen::MatrixBase<B>& b) {
        forward += add(a, b);
    }
    template <class A, class B>
    void add_reverse(const Eigen::MatrixBase<A>& a, const Eigen::MatrixBase<B>& b) {
        reverse += add(a, b);
    }
    template <class P>
    void add_reverse_fields(const P& g, const P& dp) {
        P::fields([&](const std::string&, const auto& a, const auto& b) { add_reverse(a, b); }, g,
                  dp);
    }
    double error() const { return std::abs(forward - reverse) / terms; }

  private:
    template <class A, class B>
    double add(const Eigen::MatrixBase<A>& a, const Eigen::MatrixBase<B>& b) {
        const Eigen::ArrayXXd p = a.derived().template cast<double>().array() *
                                  b.derived().template cast<double>().array();
        terms += p.abs().sum();
        return p.sum();
    }
};

} // namespace rye
