// SPDX-License-Identifier: Apache-2.0
/// rye/gaussian/gaussians.hpp: anisotropic 3D Gaussians, ready to be rendered.
/// World frame, activated: scale is a length, opacity a probability. A column per Gaussian.
#pragma once

#include <string>

#include <rye/core/error.hpp>
#include <rye/core/fields.hpp>

namespace rye {

/// N Gaussians with C feature channels. convert_fields (core/fields.hpp) copies them to another T.
template <class T>
struct Gaussians {
    Columns<T> mean;      ///< 3 x N  [world units]
    Columns<T> rotation;  ///< 4 x N  quaternions (w, x, y, z) of any norm; 0: identity
    Columns<T> scale;     ///< 3 x N  standard deviations along the local axes, >= 0 [world units]
    Columns<T> opacity;   ///< 1 x N  in 0..1
    Columns<T> feature;   ///< C x N  colour, or any other quantity to blend

    Gaussians() = default;
    Gaussians(Index count, Index channels)
        : mean(3, count), rotation(4, count), scale(3, count), opacity(1, count),
          feature(channels, count) {}

    /// Changes the shape; if it differs, all numbers are lost.
    void resize(Index count, Index channels) {
        mean.resize(3, count);
        rotation.resize(4, count);
        scale.resize(3, count);
        opacity.resize(1, count);
        feature.resize(channels, count);
    }
    Index count() const { return mean.cols(); }
    Index channels() const { return feature.rows(); }

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        f(std::string("mean"), p.mean...);
        f(std::string("rotation"), p.rotation...);
        f(std::string("scale"), p.scale...);
        f(std::string("opacity"), p.opacity...);
        f(std::string("feature"), p.feature...);
    }
};

namespace detail {

/// Columns [begin, begin + count) of a cloud.
struct ColumnRange {
    Index begin = 0, count = 0;
};

/// Throws an Error unless every array has its number of rows and one column per Gaussian.
template <class T>
void check_shapes(const std::string& who, const Gaussians<T>& g) {
    const Index n = g.count();
    const auto check = [&](const char* name, const Columns<T>& a, Index rows) {
        if (a.rows() == rows && a.cols() == n) return;
        throw Error(who + ": " + name + " is " + std::to_string(a.rows()) + " x " +
                    std::to_string(a.cols()) + ", expected " + std::to_string(rows) + " x " +
                    std::to_string(n));
    };
    check("mean", g.mean, 3);
    check("rotation", g.rotation, 4);
    check("scale", g.scale, 3);
    check("opacity", g.opacity, 1);
    check("feature", g.feature, g.channels());
}

} // namespace detail

} // namespace rye
