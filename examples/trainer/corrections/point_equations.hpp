// SPDX-License-Identifier: Apache-2.0
/// corrections/point_equations.hpp: least squares of some shared unknowns and of many points, three
/// unknowns each, that residuals tie to the shared ones but not to each other.
/// Source: the Schur complement of bundle adjustment; Triggs et al., "Bundle adjustment - a modern
/// synthesis", 2000, 6.1.
#pragma once

#include <vector>

#include <rye/math/levenberg.hpp>

namespace rye::trainer {

/// J^T J with a block for the shared unknowns, which come first, and one of 3 x 3 for each point.
struct PointEquations {
    double cost = 0;
    VecX<double> gradient;
    Columns<double> shared;           ///< S x S; only its lower half is read
    Columns<double> tied;             ///< S x 3 P, rows of the shared unknowns
    std::vector<Mat3<double>> points; ///< symmetric

    PointEquations() = default;
    /// Equations of residuals that are the unknowns themselves, near x.
    PointEquations(const VecX<double>& x, Index shared_unknowns)
        : cost(x.squaredNorm()),
          gradient(x),
          shared(Columns<double>::Identity(shared_unknowns, shared_unknowns)),
          tied(Columns<double>::Zero(shared_unknowns, x.size() - shared_unknowns)),
          points(static_cast<std::size_t>(x.size() - shared_unknowns) / 3,
                 Mat3<double>::Identity()) {}

    bool finite() const {
        bool all = gradient.allFinite() && shared.allFinite() && tied.allFinite();
        for (const Mat3<double>& m : points) all = all && m.allFinite();
        return all;
    }
    /// Sets the damped step, as NormalEquations does.
    bool step(double damping, VecX<double>& d) const {
        const Index s = shared.rows();
        const auto damped = [&](auto matrix) {
            matrix.diagonal() *= 1 + damping;
            return matrix;
        };
        Columns<double> solved(tied.rows(), tied.cols()); // tied (points)^-1
        VecX<double> alone(tied.cols());                  // (points)^-1 gradient
        for (std::size_t p = 0; p < points.size(); ++p) {
            const auto at = 3 * static_cast<Index>(p);
            const Eigen::LLT<Mat3<double>> factor(damped(points[p]));
            if (factor.info() != Eigen::Success) return false;
            solved.middleCols<3>(at) = factor.solve(tied.middleCols<3>(at).transpose()).transpose();
            alone.segment<3>(at) = factor.solve(gradient.segment<3>(s + at));
        }
        const Columns<double> reduced = damped(shared) - solved * tied.transpose();
        const Eigen::LLT<Columns<double>> factor(reduced);
        if (factor.info() != Eigen::Success) return false;
        d.resize(gradient.size());
        d.head(s) = -factor.solve(gradient.head(s) - tied * alone);
        d.tail(tied.cols()) = -alone - solved.transpose() * d.head(s);
        return true;
    }
    VecX<double> times(const VecX<double>& d) const {
        const Index s = shared.rows();
        VecX<double> out(d.size());
        out.head(s) = shared.selfadjointView<Eigen::Lower>() * d.head(s);
        out.head(s) += tied * d.tail(tied.cols());
        out.tail(tied.cols()) = tied.transpose() * d.head(s);
        for (std::size_t p = 0; p < points.size(); ++p) {
            const Index at = s + 3 * static_cast<Index>(p);
            out.segment<3>(at) += points[p] * d.segment<3>(at);
        }
        return out;
    }
};

} // namespace rye::trainer
