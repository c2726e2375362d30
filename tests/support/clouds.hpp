// SPDX-License-Identifier: Apache-2.0
/// tests/support/clouds.hpp: random clouds of Gaussians, and their largest differences.
#pragma once

#include <algorithm>
#include <cmath>

#include <rye/core/random.hpp>
#include <rye/gaussian/cloud.hpp>
#include <rye/math/rotation.hpp>
#include <rye/math/scalar.hpp>

namespace rye::test {

/// Gaussians with numbers that every splat format holds; rotations of any length.
inline GaussianCloud<double> cloud_of(Index n, int degree) {
    GaussianCloud<double> c(n, degree);
    const Random random{3, 1};
    std::uint64_t k = 0;
    const auto fill = [&](Columns<double>& a, double from, double to) {
        for (Index i = 0; i < a.size(); ++i) a.data()[i] = from + (to - from) * random.uniform(k++);
    };
    fill(c.mean, -30, 30);
    fill(c.sh_constant, -1.7, 1.7); // colours 0.02 to 0.98
    fill(c.sh_rest, -0.8, 0.8);
    fill(c.logit_opacity, -5, 5);
    fill(c.log_scale, -9, 3);
    fill(c.rotation, -2, 2);
    return c;
}

inline double largest(const Columns<double>& a) {
    return a.size() == 0 ? 0 : a.cwiseAbs().maxCoeff();
}

inline Columns<double> opacities(const GaussianCloud<double>& c) {
    return c.logit_opacity.unaryExpr([](double x) { return sigmoid(x); });
}

/// The largest angle between the rotations of two clouds [degrees].
inline double largest_turn(const GaussianCloud<double>& a, const GaussianCloud<double>& b) {
    double worst = 0;
    for (Index i = 0; i < a.count(); ++i) {
        const Quat<double> p = quat_normalized<double>(a.rotation.col(i));
        const Quat<double> q = quat_normalized<double>(b.rotation.col(i));
        const double cosine = std::min(1.0, std::abs(p.dot(q)));
        worst = std::max(worst, 2 * std::acos(cosine) * 57.29577951308232);
    }
    return worst;
}

} // namespace rye::test
