// SPDX-License-Identifier: Apache-2.0
/// tests/support/splat_reference.hpp: references for lanes, in double and without lanes. Compiled
/// once, for all widths.
#pragma once

#include <cstdint>

#include <rye/splat/oracle.hpp>
#include <rye/splat/raster.hpp>

#include "scenes.hpp"

namespace rye::test {

/// Weights of a scene's images: the cotangents of its gradients.
template <class T>
struct Weights {
    Columns<T> feature, alpha, depth;

    Weights(const Scenery<T>& s, std::uint64_t seed)
        : Weights(s.gaussians.channels(), Index(s.camera.width) * s.camera.height, seed) {}
    Weights(Index channels, Index pixels, std::uint64_t seed)
        : feature(noise<T>(channels, pixels, seed)), alpha(noise<T>(1, pixels, seed + 1)),
          depth(noise<T>(1, pixels, seed + 2)) {}
};

/// Every Gaussian at every pixel.
OracleImages truth(const Scenery<float>& s);
OracleImages truth(const Scenery<double>& s);

/// The images and indices of contributors by plain loops.
template <class T>
struct PlainImages {
    Columns<T> feature, alpha, depth;
    Columns<std::uint32_t> contributor;
};
PlainImages<float> plain(const Scenery<float>& s, const Balanced& a);
PlainImages<float> plain(const Scenery<float>& s, const Compatible3dgs& a);
PlainImages<float> plain(const Scenery<float>& s, const Compatible3dgsFloor& a);
PlainImages<double> plain(const Scenery<double>& s, const Balanced& a);

/// <w, J v> by duals through plain loops.
double slope(const Scenery<double>& s, const Balanced& a, const Gaussians<double>& v,
             const Weights<double>& w);
double slope(const Scenery<double>& s, const Compatible3dgs& a, const Gaussians<double>& v,
             const Weights<double>& w);
double slope(const Scenery<double>& s, const Compatible3dgsFloor& a, const Gaussians<double>& v,
             const Weights<double>& w);

/// J^T w by plain loops in double, of numbers that are floats; alpha and depth may be left out.
Gaussians<double> plain_gradient(const Scenery<float>& s, const Balanced& a,
                                 const Weights<float>& w, bool extra);

} // namespace rye::test
