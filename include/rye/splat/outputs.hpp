// SPDX-License-Identifier: Apache-2.0
/// rye/splat/outputs.hpp: the images of a render besides features and alpha. An image that is not
/// asked for has no memory and costs no instruction.
#pragma once

#include <cstdint>
#include <type_traits>

#include <rye/core/absent.hpp>
#include <rye/core/columns.hpp>

namespace rye {

/// Named in the error for an image that the outputs do not have.
struct DepthImage;
struct ContributorImage;

/// Images that a render has besides features and opacity.
struct Outputs {
    bool depth = true;               ///< sum_i T_i a_i z_i
    bool contributor = false;        ///< the Gaussian that adds most to each pixel

    bool operator==(const Outputs&) const = default;
};

/// Features and alpha alone.
inline constexpr Outputs features_only{.depth = false, .contributor = false};

/// Contributor of a pixel to which nothing contributes.
inline constexpr std::uint32_t no_contributor = 0xFFFFFFFF;

namespace detail {

/// The images that a render with these outputs has.
template <class T, Outputs O>
struct OutputImages {
    /// Depth times alpha, 1 x pixels; divided by alpha, if positive, the expected depth
    /// [world units].
    [[no_unique_address]] PresentIf<O.depth, DepthImage, Image<T>> depth;
    /// Indices of Gaussians, or no_contributor; of equal weights the nearer one. No derivative.
    [[no_unique_address]] PresentIf<O.contributor, ContributorImage, Image<std::uint32_t>>
        contributor;
};

} // namespace detail

/// Policy A with other outputs.
template <class A, Outputs O>
struct Drawing : A {
    RYE_HD constexpr Drawing(const A& a = {}) : A(a) {}
    static constexpr Outputs outputs = O;
};
/// Policy A, for features and alpha alone.
template <class A>
using FeaturesOnly = std::conditional_t<A::outputs == features_only, A, Drawing<A, features_only>>;

} // namespace rye
