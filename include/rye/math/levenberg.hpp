// SPDX-License-Identifier: Apache-2.0
/// rye/math/levenberg.hpp: least squares by Gauss-Newton steps with Levenberg's damping, for up to
/// some hundred unknowns: the caller sums J^T J, and no Jacobian is kept. More unknowns are solved
/// for where the caller's equations know how their matrix is made (LeastSquaresEquations).
///     const auto found = levenberg(start, settings, linearized, cost);
///     found.x, covariance(found.at.matrix)
/// The damping is Marquardt's, relative to the matrix's diagonal.
/// Source: Levenberg, 1944; Marquardt, 1963; the gain ratio as in Madsen, Nielsen and Tingleff,
/// "Methods for non-linear least squares problems", 2004, 3.2.
#pragma once

#include <algorithm>
#include <cmath>
#include <concepts>
#include <string>
#include <type_traits>

#include <rye/core/eigen.hpp>

#include <Eigen/Cholesky>

#include <rye/core/columns.hpp>
#include <rye/core/concepts.hpp>
#include <rye/core/error.hpp>
#include <rye/core/format.hpp>

namespace rye {

/// A sum of squares near x: cost(x + d) = cost + 2 d^T gradient + d^T matrix d.
template <Real T>
struct NormalEquations {
    T cost = T(0);
    Columns<T> matrix; ///< J^T J, n x n; only its lower half is read
    VecX<T> gradient;  ///< J^T r, n

    bool finite() const { return matrix.allFinite() && gradient.allFinite(); }
    /// Sets d = -(matrix + damping diagonal)^-1 gradient; returns false, and sets nothing, where
    /// that matrix is not positive definite.
    bool step(const T& damping, VecX<T>& d) const {
        Columns<T> damped = matrix;
        damped.diagonal() += damping * matrix.diagonal();
        const Eigen::LLT<Columns<T>> factor(damped);
        if (factor.info() != Eigen::Success) return false;
        d = -factor.solve(gradient);
        return true;
    }
    /// Returns matrix d.
    VecX<T> times(const VecX<T>& d) const {
        return matrix.template selfadjointView<Eigen::Lower>() * d;
    }
};

/// Equations near a point: its cost and gradient, steps that are damped, and products with J^T J.
template <class E, class T>
concept LeastSquaresEquations = requires(const E& e, VecX<T>& d) {
    { e.cost } -> std::convertible_to<T>;
    { e.gradient } -> std::convertible_to<const VecX<T>&>;
    { e.finite() } -> std::same_as<bool>;
    { e.step(T(0), d) } -> std::same_as<bool>;
    { e.times(d) } -> std::convertible_to<VecX<T>>;
};

/// When steps end, and how far they go.
struct LevenbergSettings {
    int steps = 10;             ///< most steps that are taken
    double damping = 1e-3;      ///< of the first step, relative to the diagonal
    double raise = 10;          ///< factor of the damping after a step that is refused
    double lower = 0.1;         ///< factor of the damping after a good step
    double most_damping = 1e6;  ///< where it gives up
    double tolerance = 1e-4;    ///< relative decrease of the cost at which it has settled
};

/// The result of the steps.
template <Real T, LeastSquaresEquations<T> E = NormalEquations<T>>
struct LevenbergResult {
    VecX<T> x;
    T first_cost = T(0);
    E at;                  ///< of x
    int steps = 0;         ///< taken
    int refused = 0;       ///< trials that made the cost larger, or not finite
    bool settled = false;  ///< the last step changed little, or none makes the cost smaller
};

/// (matrix)^-1 of a positive definite matrix: the covariance of the unknowns where residuals have
/// the variance 1. Throws Error for another matrix.
template <Real T>
Columns<T> covariance(const Columns<T>& matrix) {
    const Eigen::LLT<Columns<T>> factor(matrix);
    require(factor.info() == Eigen::Success && matrix.allFinite(), "covariance",
            "got a matrix of " + std::to_string(matrix.rows()) +
                " rows that is not positive definite");
    return factor.solve(Columns<T>::Identity(matrix.rows(), matrix.cols()));
}

/// Minimises a sum of squares from `start` on. linearized(x) returns its NormalEquations, or others
/// that are LeastSquaresEquations; cost(x) its value alone. A trial whose cost is not finite is
/// refused as one whose cost is larger is. Throws Error if the cost, the matrix or the gradient is
/// not finite at a point that it stands on.
template <Real T, class Linearized, class Cost>
auto levenberg(const VecX<T>& start, const LevenbergSettings& settings, Linearized&& linearized,
               Cost&& cost) {
    LevenbergResult<T, std::invoke_result_t<Linearized&, const VecX<T>&>> r;
    r.x = start;
    const auto stand = [&] {
        r.at = linearized(r.x);
        require(std::isfinite(r.at.cost), "levenberg",
                "step " + std::to_string(r.steps) + ": the sum of squares is " +
                    number_text(r.at.cost) + ", expected a finite number");
        require(r.at.finite(), "levenberg",
                "step " + std::to_string(r.steps) + ": a derivative is not finite");
    };
    stand();
    r.first_cost = r.at.cost;
    double damping = settings.damping;
    while (r.steps < settings.steps && !r.settled) {
        VecX<T> d;
        T tried = T(0), expected = T(0);
        bool smaller = r.at.step(T(damping), d);
        if (smaller) {
            const VecX<T> md = r.at.times(d);
            expected = -(T(2) * d.dot(r.at.gradient) + d.dot(md));
            tried = cost(VecX<T>(r.x + d));
            smaller = std::isfinite(tried) && tried < r.at.cost;
        }
        if (!smaller) {
            ++r.refused;
            damping = std::max(damping, 1e-12) * settings.raise;
            r.settled = damping > settings.most_damping;
            continue;
        }
        const T decrease = r.at.cost - tried;
        r.settled = decrease <= T(settings.tolerance) * r.at.cost;
        r.x += d;
        ++r.steps;
        if (decrease < T(0.25) * expected)
            damping *= settings.raise;
        else if (decrease > T(0.75) * expected)
            damping *= settings.lower;
        stand();
    }
    return r;
}

} // namespace rye
