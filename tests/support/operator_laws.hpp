// SPDX-License-Identifier: Apache-2.0
/// tests/support/operator_laws.hpp: the laws of derivatives, operator by operator, over many draws:
/// the dot product <J v, w> = <v, J'w>, every entry of J'w, the central difference, and the second
/// derivative by nested duals. A draw has 16 points at once, so that its sums do not vanish by
/// chance. Arguments of a program: the number of draws and --flush-to-zero.
#pragma once

#include <cstdio>
#include <cstdlib>

#include <rye/autodiff/check.hpp>
#include <rye/math/linalg.hpp>

#include "flush_to_zero.hpp"

namespace rye::laws {

inline int draws = 10000;
inline int failed = 0;

inline void demand(const char* name, const char* law, const char* scalar, double reached,
                   double allowed) {
    const bool kept = reached <= allowed; // false for NaN
    if (!kept) ++failed;
    std::printf("%-28s %-12s %-6s %9.2e of %7.1e %s\n", name, law, scalar, reached, allowed,
                kept ? "" : "BROKEN");
}

inline void keep(double& worst, double x) {
    if (!(x <= worst)) worst = x;
}

constexpr Index points = 16;

/// Mutants are tested on first derivatives in double alone, which compiles in half the time.
#ifdef RYE_QUICK_LAWS
constexpr bool quick = true;
#else
constexpr bool quick = false;
#endif

/// op(column of n) -> column of m over any scalar; vjp(column, cotangent) -> column of n.
template <class T, class Op, class Vjp>
void first_order(const char* name, Index n, Index m, const Op& op, const Vjp& vjp,
                 double spread = 1) {
    const auto f = [&](const auto& x) {
        using S = typename std::decay_t<decltype(x)>::Scalar;
        Columns<S> y(m, x.cols());
        for (Index j = 0; j < x.cols(); ++j) y.col(j) = op(Columns<S>(x.col(j)));
        return y;
    };
    const bool single = sizeof(T) == 4;
    const char* scalar = single ? "float" : "double";
    double dot = 0, entry = 0, difference = 0;
    for (int k = 0; k < draws; ++k) {
        const Random r{static_cast<std::uint64_t>(k) * 4 + 1, 0};
        const Columns<T> x = random_columns<T>(n, points, r.fork(0)) * static_cast<T>(spread);
        const Columns<T> v = random_columns<T>(n, points, r.fork(1));
        const Columns<T> w = random_columns<T>(m, points, r.fork(2));
        const auto back_at = [&](const Columns<T>& at, const Columns<T>& c) {
            Columns<T> out(n, points);
            for (Index j = 0; j < points; ++j)
                out.col(j) = vjp(Columns<T>(at.col(j)), Columns<T>(c.col(j)));
            return out;
        };
        const auto back = [&](const Columns<T>& c) { return back_at(x, c); };
        keep(dot, detail::dot_product_test(f, back, x, v, w));
        if (k % 10 != 0) continue;
        const Columns<T> g = back(w);
        for (Index j = 0; j < points && k % 100 == 0; ++j) {
            const Columns<T> at = x.col(j);
            const Columns<T> jw = jacobian(f, at).transpose() * w.col(j);
            keep(entry,
                 double((jw - g.col(j)).cwiseAbs().maxCoeff()) / double(g.cwiseAbs().maxCoeff()));
        }
        if constexpr (sizeof(T) == 8) {
            // Near the origin of a direction, differences see the third derivative.
            Columns<T> away = x;
            for (Index j = 0; j < points; ++j)
                if (const double size = x.col(j).norm(); size < 0.5) away.col(j) *= 0.5 / size;
            const auto there = [&](const Columns<T>& c) { return back_at(away, c); };
            keep(difference, detail::difference_test(f, there, away, v, w));
        }
    }
    demand(name, "dot product", scalar, dot, single ? 2e-6 : 1e-14);
    demand(name, "entries", scalar, entry, single ? 2e-6 : 5e-15);
    if (!single) demand(name, "difference", scalar, difference, 1e-8);
}

/// Second derivatives of <w, op(x)>: nested duals are symmetric and agree with differences of the
/// first.
template <class Op>
void second_order(const char* name, Index n, Index m, const Op& op, double spread = 1) {
    using D = Dual<double, 1>;
    using DD = Dual<D, 1>;
    double symmetry = 0, difference = 0;
    for (int k = 0; k < std::min(draws, 20); ++k) {
        const Random r{static_cast<std::uint64_t>(k) * 4 + 2, 0};
        const Columns<double> x = random_columns<double>(n, 1, r.fork(0)) * spread;
        const Columns<double> w = random_columns<double>(m, 1, r.fork(1));
        const auto slope = [&](const Columns<double>& at, Index j) {
            Columns<D> d(n, 1);
            for (Index i = 0; i < n; ++i) d(i, 0) = D(at(i, 0)), d(i, 0).d[0] = i == j ? 1 : 0;
            const Columns<D> y = op(d);
            double sum = 0;
            for (Index i = 0; i < m; ++i) sum += w(i, 0) * y(i, 0).d[0];
            return sum;
        };
        Columns<double> h(n, n), fd(n, n);
        for (Index i = 0; i < n; ++i)
            for (Index j = 0; j < n; ++j) {
                Columns<DD> d(n, 1);
                for (Index q = 0; q < n; ++q) {
                    d(q, 0) = DD(D(x(q, 0)));
                    if (q == i) d(q, 0).value.d[0] = 1;
                    if (q == j) d(q, 0).d[0] = D(1.0);
                }
                const Columns<DD> y = op(d);
                h(i, j) = 0;
                for (Index q = 0; q < m; ++q) h(i, j) += w(q, 0) * y(q, 0).d[0].d[0];
                Columns<double> a = x, b = x;
                a(i, 0) += 6e-6, b(i, 0) -= 6e-6;
                fd(i, j) = (slope(a, j) - slope(b, j)) / 12e-6;
            }
        const double size = std::max(1e-3, h.cwiseAbs().maxCoeff());
        keep(symmetry, (h - h.transpose()).cwiseAbs().maxCoeff() / size);
        keep(difference, (h - fd).cwiseAbs().maxCoeff() / size);
    }
    demand(name, "symmetry", "double", symmetry, 1e-13);
    demand(name, "2nd diff.", "double", difference, 1e-7);
}

template <class Op, class Vjp>
void every_law(const char* name, Index n, Index m, const Op& op, const Vjp& vjp,
               double spread = 1) {
    first_order<double>(name, n, m, op, vjp, spread);
    if constexpr (!quick) {
        first_order<float>(name, n, m, op, vjp, spread);
        second_order(name, n, m, op, spread);
    }
}

inline int run(int argc, char** argv, void (*laws)()) {
    flush_to_zero_if_asked(argc, argv);
    if (argc > 1 && argv[1][0] != '-') draws = std::max(1, std::atoi(argv[1]));
    laws();
    return failed == 0 ? 0 : 1;
}

/// The first entries of a column as a small vector, and back.
template <int N, class S>
Vec<S, N> part(const Columns<S>& x, Index from = 0) {
    Vec<S, N> v;
    for (int i = 0; i < N; ++i) v[i] = x(from + i, 0);
    return v;
}
template <class V>
Columns<typename V::Scalar> column(const V& v) {
    Columns<typename V::Scalar> c(v.size(), 1);
    for (Index i = 0; i < v.size(); ++i) c(i, 0) = v.data()[i];
    return c;
}

} // namespace rye::laws
