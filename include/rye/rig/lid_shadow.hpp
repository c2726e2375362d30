// SPDX-License-Identifier: Apache-2.0
/// rye/rig/lid_shadow.hpp: the shadow that the upper lid and its lashes cast on an eyeball: ambient
/// occlusion by the distance below the lid's line.
/// Frame: the eye opening's, origin at the eyeball's centre, axes of the head's frame (x across, y
/// up), lengths in radii of the eyeball, the farthest distance of its points from the centre.
/// The line's height over x is a quadratic B-spline of lid_nodes uniform nodes; each is the mean
/// height of the lid's points, weighted by a Gaussian of their distance from it in x, so that it is
/// defined and smooth wherever they are. A colour at a depth d below the line is multiplied by
///     1 - a exp(-t^2 / (1 + t)),   t = max(d, 0) / s
/// which has a continuous slope at d = 0 and decays as exp(-t).
/// Approximations: what a lid hides of the sky is a function of this vertical distance alone; the
/// lower lid casts nothing.
#pragma once

#include <cmath>

#include <rye/core/array.hpp>
#include <rye/core/columns.hpp>
#include <rye/math/linalg.hpp>
#include <rye/math/scalar.hpp>

namespace rye {

/// Heights of a lid's line.
inline constexpr int lid_nodes = 12;
/// Numbers that are trained for an eye: logit of a, log of s [radii], the line's offset up [radii].
inline constexpr int lid_numbers = 3;

namespace detail {

/// Standard deviation in x by which points count for a node [radii].
inline constexpr double lid_node_width = 0.15;
/// Bound on the logarithm of s, beyond which it has no effect, and on t.
inline constexpr double most_log_width = 7, most_lid_depth = 64;
/// Bound on a point's distance from a node, in standard deviations.
inline constexpr double most_lid_distance = 1000;

/// Returns the place of a node in x; those of nodes 1 and lid_nodes - 2 are -1 and 1.
template <Scalar T>
RYE_HD T lid_node(int node) {
    return constant<T>(2.0 / (lid_nodes - 3) * (node - 1) - 1);
}

/// Points of a lid, 2 x count, and how they count for a node.
template <class T>
struct LidArc {
    const T* at; ///< x and y
    Index count; ///< above 0

    /// Returns the distance of point k from a node in standard deviations, bounded.
    RYE_HD T distance(int node, Index k) const {
        const T z = (lid_node<T>(node) - at[2 * k]) * constant<T>(1 / lid_node_width);
        const T most = constant<T>(most_lid_distance);
        return z < most ? (z > -most ? z : T(-most)) : most;
    }
    /// Returns the logarithm of the largest weight at a node.
    RYE_HD T nearest(int node) const {
        T most = constant<T>(-most_lid_distance * most_lid_distance);
        for (Index k = 0; k < count; ++k) {
            const T z = distance(node, k), log_weight = constant<T>(-0.5) * z * z;
            if (log_weight > most) most = log_weight;
        }
        return most;
    }
    RYE_HD T weight(int node, Index k, const T& most) const {
        using std::exp;
        const T z = distance(node, k);
        return exp(constant<T>(-0.5) * z * z - most);
    }
    /// Returns the sum of the weights at a node, and the height of the line there.
    struct Mean {
        T most, sum, height;
    };
    RYE_HD Mean mean(int node) const {
        Mean m{nearest(node), T(0), T(0)};
        for (Index k = 0; k < count; ++k) {
            const T w = weight(node, k, m.most);
            m.sum += w;
            m.height += w * at[2 * k + 1];
        }
        m.height /= m.sum;
        return m;
    }
    /// Adds to g the cotangent of point k, given those of the heights at all nodes.
    RYE_HD void vjp(Index k, const T* g_height, T* g) const {
        const T most = constant<T>(most_lid_distance);
        for (int node = 0; node < lid_nodes; ++node) {
            const Mean m = mean(node);
            const T z = distance(node, k), share = g_height[node] * weight(node, k, m.most) / m.sum;
            if (z > -most && z < most)
                g[0] += share * (at[2 * k + 1] - m.height) * z * constant<T>(1 / lid_node_width);
            g[1] += share;
        }
    }
};

/// Three nodes of a lid's line, what they count for at a place x, and the slopes of that.
template <class T>
struct LidPlace {
    int first;
    T weight[3], slope[3];

    RYE_HD explicit LidPlace(const T& x) {
        const T one(1), bounded = x > -one ? (x < one ? x : one) : T(-one);
        const T per = constant<T>((lid_nodes - 3) / 2.0), q = (bounded + one) * per + one;
        const int middle = static_cast<int>(value_of(q) + real_t<T>(0.5));
        const T t = q - T(middle), half = constant<T>(0.5), before = half - t, after = half + t;
        first = middle - 1;
        weight[0] = half * before * before;
        weight[1] = constant<T>(0.75) - t * t;
        weight[2] = half * after * after;
        const T inside = x > -one && x < one ? per : T(0);
        slope[0] = -before * inside;
        slope[1] = T(-2) * t * inside;
        slope[2] = after * inside;
    }
};

} // namespace detail

/// An eye and its upper lid in a frame.
template <Scalar T>
struct LidOfEye {
    Array<T, std::size_t(lid_nodes)> height; ///< of the line's nodes [radii]
    Vec3<T> across, up; ///< x and y of a point of the eyeball's frame are its products with these
    T strength;         ///< a, in [0, 1]
    T width;            ///< s [radii]
    T offset;           ///< of the line, up [radii]
};

/// Sets the trained numbers of an eye: logit of a, log of s, offset.
template <Scalar T>
RYE_HD void set_lid_numbers(const T* numbers, LidOfEye<T>& lid) {
    using std::exp;
    const T most = constant<T>(detail::most_log_width);
    lid.strength = sigmoid(numbers[0]);
    lid.width = exp(clamp_value(numbers[1], T(-most), most));
    lid.offset = numbers[2];
}
/// Sets the turn of an eyeball of that radius [unit] in the head.
template <Scalar T>
RYE_HD void set_lid_turn(const Mat3<T>& turn, const T& radius, LidOfEye<T>& lid) {
    for (int k = 0; k < 3; ++k) {
        lid.across[k] = turn(0, k) / radius;
        lid.up[k] = turn(1, k) / radius;
    }
}

/// The shadow at a point of the eyeball's frame.
template <Scalar T>
struct LidShade {
    detail::LidPlace<T> place;
    T depth;  ///< t, bounded
    T shade;  ///< in [0, 1]
    T factor; ///< of colours

    RYE_HD LidShade(const LidOfEye<T>& lid, const Vec3<T>& point) : place(dot(lid.across, point)) {
        using std::exp;
        T line = lid.offset - dot(lid.up, point);
        for (int k = 0; k < 3; ++k)
            line += place.weight[k] * lid.height[std::size_t(place.first + k)];
        const T t = line / lid.width, most = constant<T>(detail::most_lid_depth);
        depth = t > T(0) ? (t < most ? t : most) : T(0);
        shade = exp(-depth * (depth / (T(1) + depth)));
        factor = T(1) - lid.strength * shade;
    }
};

/// Places of what the points of an eye are summed for: cotangents of a LidOfEye's heights, of
/// `across`, of `up`, and of the trained numbers.
struct LidSums {
    static constexpr int height_at = 0, across_at = lid_nodes, up_at = across_at + 3,
                         numbers_at = up_at + 3, count = numbers_at + lid_numbers;
};

/// Adds to sums what the cotangent of the factor at a point gives.
template <Scalar T, class Sums>
RYE_HD void lid_shade_vjp(const LidOfEye<T>& lid, const Vec3<T>& point, const LidShade<T>& at,
                          const T& g_factor, Sums& sum) {
    const auto add = [&](int place, const T& g) { sum[std::size_t(place)] += g; };
    const T& t = at.depth;
    add(LidSums::numbers_at, -g_factor * at.shade * (lid.strength * (T(1) - lid.strength)));
    if (!(t > T(0) && t < constant<T>(detail::most_lid_depth))) return;
    const T more = T(1) + t;
    const T g_t = g_factor * lid.strength * at.shade * (t * (T(2) + t) / (more * more));
    const T g_line = g_t / lid.width;
    add(LidSums::numbers_at + 1, -t * g_t);
    add(LidSums::numbers_at + 2, g_line);
    T g_x(0);
    for (int k = 0; k < 3; ++k) {
        const int node = at.place.first + k;
        add(LidSums::height_at + node, at.place.weight[k] * g_line);
        g_x += at.place.slope[k] * lid.height[std::size_t(node)] * g_line;
    }
    for (int k = 0; k < 3; ++k) {
        add(LidSums::across_at + k, g_x * point[k]);
        add(LidSums::up_at + k, -g_line * point[k]);
    }
}

/// Adds the gradient of an eye's trained numbers to g, given its sums: a logarithm beyond its bound
/// gets none.
template <Scalar T, class Sums>
RYE_HD void lid_numbers_vjp(const T* numbers, const Sums& sum, T* g) {
    const T most = constant<T>(detail::most_log_width);
    const bool bounded = numbers[1] > most || numbers[1] < -most;
    for (int k = 0; k < lid_numbers; ++k)
        if (k != 1 || !bounded) g[k] += sum[LidSums::numbers_at + k];
}
/// Returns the cotangent of the turn of an eyeball of that radius, given its sums.
template <Scalar T, class Sums>
RYE_HD Mat3<T> lid_turn_vjp(const Sums& sum, const T& radius) {
    Mat3<T> g;
    for (int k = 0; k < 3; ++k) {
        g(0, k) = sum[LidSums::across_at + k] / radius;
        g(1, k) = sum[LidSums::up_at + k] / radius;
        g(2, k) = T(0);
    }
    return g;
}

} // namespace rye
