// SPDX-License-Identifier: Apache-2.0
/// benchmarks/accuracy/errors.hpp: errors of images and gradients relative to exact ones.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include <rye/core/fields.hpp>
#include <rye/gaussian/gaussians.hpp>

namespace rye::bench {

struct ImageError {
    double largest = 0, rms = 0;
    double psnr() const { return rms > 0 ? -20 * std::log10(rms) : 999.0; } ///< [dB], peak 1
};

inline ImageError image_error(const Columns<double>& a, const Columns<double>& truth) {
    const Columns<double> d = a - truth;
    if (!d.allFinite()) return {INFINITY, INFINITY};
    return {d.cwiseAbs().maxCoeff(), std::sqrt(d.cwiseAbs2().mean())};
}

/// Errors of the gradient of one group of parameters.
struct GroupError {
    std::string name;
    double relative = 0; ///< |g - truth| / |truth|
    double cosine = 1;
    double worst = 0; ///< largest entry of g - truth over the largest of truth
};

inline std::vector<GroupError> gradient_errors(const Gaussians<double>& g,
                                               const Gaussians<double>& truth) {
    std::vector<GroupError> all;
    Gaussians<double>::fields(
        [&](const std::string& name, const Columns<double>& a, const Columns<double>& t) {
            const double nt = t.norm(), na = a.norm();
            if (nt == 0) return;
            all.push_back({name, (a - t).norm() / nt, (a.cwiseProduct(t)).sum() / (na * nt),
                           (a - t).cwiseAbs().maxCoeff() / t.cwiseAbs().maxCoeff()});
        },
        g, truth);
    return all;
}

} // namespace rye::bench
