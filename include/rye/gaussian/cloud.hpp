// SPDX-License-Identifier: Apache-2.0
/// rye/gaussian/cloud.hpp: Gaussians as they are trained and stored: unconstrained numbers in place
/// of scales, opacities and colours. World frame; a column per Gaussian.
#pragma once

#include <rye/core/memory.hpp>
#include <rye/gaussian/gaussians.hpp>
#include <rye/math/harmonics.hpp>

namespace rye {

/// N Gaussians as stored, with spherical harmonics of one degree.
template <class T>
struct GaussianCloud {
    Columns<T> mean;           ///< 3 x N  [world units]
    Columns<T> sh_constant;    ///< 3 x N  band 0 of red, green, blue ("f_dc")
    Columns<T> sh_rest;        ///< 3 K x N  the other K coefficients of red, of green, of blue
    Columns<T> logit_opacity;  ///< 1 x N
    Columns<T> log_scale;      ///< 3 x N
    Columns<T> rotation;       ///< 4 x N  quaternions (w, x, y, z), any norm; 0: identity

    GaussianCloud() = default;
    GaussianCloud(Index count, int degree)
        : mean(3, count), sh_constant(3, count), sh_rest(3 * (sh_count(degree) - 1), count),
          logit_opacity(1, count), log_scale(3, count), rotation(4, count) {}

    /// Returns the bytes that N Gaussians of a degree take.
    static std::uint64_t memory(Index count, int degree) {
        const auto numbers = static_cast<std::uint64_t>(14 + 3 * (sh_count(degree) - 1));
        return saturated_product(static_cast<std::uint64_t>(count), numbers * sizeof(T));
    }

    Index count() const { return mean.cols(); }
    int degree() const { return sh_degree(static_cast<int>(sh_rest.rows() / 3) + 1); }

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        f(std::string("mean"), p.mean...);
        f(std::string("sh_constant"), p.sh_constant...);
        f(std::string("sh_rest"), p.sh_rest...);
        f(std::string("logit_opacity"), p.logit_opacity...);
        f(std::string("log_scale"), p.log_scale...);
        f(std::string("rotation"), p.rotation...);
    }
};

/// Returns the cloud without harmonics above `degree`; unchanged if it has none.
template <class T>
GaussianCloud<T> truncated(const GaussianCloud<T>& cloud, int degree) {
    if (degree >= cloud.degree()) return cloud;
    GaussianCloud<T> r(cloud.count(), degree);
    r.mean = cloud.mean;
    r.sh_constant = cloud.sh_constant;
    r.logit_opacity = cloud.logit_opacity;
    r.log_scale = cloud.log_scale;
    r.rotation = cloud.rotation;
    const Index kept = r.sh_rest.rows() / 3, of = cloud.sh_rest.rows() / 3;
    for (Index c = 0; c < 3; ++c)
        r.sh_rest.middleRows(c * kept, kept) = cloud.sh_rest.middleRows(c * of, kept);
    return r;
}

} // namespace rye
