// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/eye_lids.hpp: the shadows of the upper lids on the eyeballs (rig/lid_shadow.hpp), for
/// the effect LidShadow: the lids' points, which Gaussians of the driven face carry along as far as
/// they are driven from where they rest, before the head's motion; what they take from the first
/// channels of the eyes' features, highlights included, and back. Functions of a point run on the
/// host (backend/each.hpp) and on a device (backend/cuda/each.hpp).
/// Frames: the lids' points and the eyes' turns and centres in the head's, canonical units; points
/// of an eye in the eyeball's.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

#include <rye/avatar/eye_points.hpp>
#include <rye/avatar/frame_cotangent.hpp>
#include <rye/core/bits.hpp>
#include <rye/core/column_array.hpp>
#include <rye/rig/lid_shadow.hpp>

namespace rye {

namespace detail {

/// Channels that a lid darkens, the first ones.
inline constexpr int shaded_channels = 3;

/// Darkens point i of an eye. Arrays begin at that eye's first point.
template <class T>
struct ShadeEyePoint {
    static constexpr const char* name = "eyes, shadows of lids";
    const T* position;      ///< in the eyeball's frame, 3 x P
    const LidOfEye<T>* lid; ///< of that eye
    Index channels;         ///< of a feature
    T* feature;             ///< channels x P
    T* plain;               ///< shaded_channels x P, receives the colours before; or null

    RYE_HD void operator()(Index i) const {
        const LidShade<T> at(*lid, column3(position, i));
        T* const colour = feature + channels * i;
        for (int c = 0; c < shaded_channels; ++c) {
            if (plain != nullptr) plain[shaded_channels * i + c] = colour[c];
            colour[c] *= at.factor;
        }
    }
};

/// Sets the cotangents of the features of point i before the shadow, and adds to the sums of its
/// lid.
template <class T>
struct ShadeEyePointVjp {
    using Number = T;
    static constexpr const char* name = "eyes, shadows of lids, reverse";
    static constexpr int sums = LidSums::count;
    const T* position;
    const LidOfEye<T>* lid;
    Index channels;
    const T* plain; ///< shaded_channels x P
    const T* g;     ///< of the features, channels x P
    T* g_plain;     ///< may be g's

    template <class Sums>
    RYE_HD void operator()(Index i, Sums& sum) const {
        const Vec3<T> point = column3(position, i);
        const LidShade<T> at(*lid, point);
        T g_factor(0);
        for (int c = 0; c < shaded_channels; ++c) {
            const T own = g[channels * i + c];
            g_factor += own * plain[shaded_channels * i + c];
            g_plain[channels * i + c] = own * at.factor;
        }
        if (g_plain != g)
            for (Index c = shaded_channels; c < channels; ++c)
                g_plain[channels * i + c] = g[channels * i + c];
        lid_shade_vjp(*lid, point, at, g_factor, sum);
    }
};

/// Returns the farthest distance of an eye's points from its centre, the unit of its lid; 1 where
/// all are there.
template <class T, EffectSet E>
T eyeball_radius(const EyeStream<T, E>& eyes, Index eye) {
    using std::sqrt;
    T most(0);
    const Index first = eyes.first_point(eye);
    for (Index i = first; i < first + eyes.points_of(eye); ++i) {
        const Vec3<T> p = eyes.position.col(i);
        const T squared = dot(p, p);
        if (squared > most) most = squared;
    }
    return most > T(0) ? T(sqrt(most)) : T(1);
}

/// Throws an Error unless the lids' numbers and points have the shapes that belong together, for a
/// face of so many Gaussians.
template <class T, EffectSet E>
    requires has_effect<E, LidShadow>
void check_lids(const EyeStream<T, E>& eyes, Index face) {
    const Columns<T>& line = eyes.lid_line;
    require(eyes.lid_shadow.rows() == lid_numbers && eyes.lid_shadow.cols() == 2, "eye_lids",
            "got lid_shadow of ", eyes.lid_shadow.rows(), " x ", eyes.lid_shadow.cols(),
            ", expected ", lid_numbers, " x 2");
    require(line.rows() == 3 && line.cols() >= 2 && line.cols() % 2 == 0, "eye_lids",
            "got lid_line of ", line.rows(), " x ", line.cols(), ", expected 3 x 2 K");
    for (Index k = 0; k < line.cols(); ++k) {
        const double i = static_cast<double>(value_of(line(0, k)));
        require(i >= 0 && i < static_cast<double>(face) && i == std::floor(i), "eye_lids",
                "number ", k, " of lid_line is ", i, ", expected a Gaussian of the face, 0 to ",
                face - 1);
    }
}
/// Returns the column of the face's Gaussian that carries point k of the lids.
template <class T>
Index lid_column(const Columns<T>& line, Index k) {
    return static_cast<Index>(value_of(line(0, k)));
}

/// The lids of both eyes in a frame.
template <class T>
struct FrameLids {
    Columns<T> points;             ///< x and y, 2 x 2K; empty without shadows
    std::array<Vec3<T>, 2> centre; ///< of the eyes
    std::array<LidOfEye<T>, 2> eye;
    Columns<T> plain; ///< the eyes' colours before, shaded_channels x P

    Index points_of_eye() const { return points.cols() / 2; }
    /// Returns x and y of an eye's points from its centre, over its radius, 2 x K.
    Columns<T> around(std::size_t e, const T& radius) const {
        const Index n = points_of_eye(), first = static_cast<Index>(e) * n;
        Columns<T> at(2, n);
        for (Index k = 0; k < n; ++k)
            for (Index a = 0; a < 2; ++a) at(a, k) = (points(a, first + k) - centre[e][a]) / radius;
        return at;
    }
};

/// Sets the lids' points by the driven face's means, head frame, 3 x N or more, and its positions
/// at rest, 3 x N.
template <class T, EffectSet E, class Lids>
void take_lid_points([[maybe_unused]] const EyeStream<T, E>& eyes,
                     [[maybe_unused]] const Columns<T>& mean,
                     [[maybe_unused]] const Columns<T>& rest, [[maybe_unused]] Lids& lids) {
    if constexpr (has_effect<E, LidShadow>) {
        lids.points.resize(2, eyes.lid_line.cols());
        if (lids.points.size() == 0) return;
        check_lids(eyes, rest.cols());
        for (Index k = 0; k < lids.points.cols(); ++k) {
            const Index i = lid_column(eyes.lid_line, k);
            for (Index a = 0; a < 2; ++a)
                lids.points(a, k) = eyes.lid_line(1 + a, k) + (mean(a, i) - rest(a, i));
        }
    }
}

/// Sets the lid of an eye (0: the subject's left), whose centre in the head this is.
template <std::size_t eye, class T, EffectSet E>
    requires has_effect<E, LidShadow>
void place_lid(const EyeStream<T, E>& eyes, const Vec3<T>& centre,
               const OpticalDrivers<T, E>& optical, FrameLids<T>& lids) {
    constexpr Index e = static_cast<Index>(eye);
    const T radius = eyeball_radius(eyes, e);
    lids.centre[eye] = centre;
    const Columns<T> at = lids.around(eye, radius);
    LidOfEye<T>& lid = lids.eye[eye];
    for (int node = 0; node < lid_nodes; ++node)
        lid.height[std::size_t(node)] = LidArc<T>{at.data(), at.cols()}.mean(node).height;
    set_lid_turn(placed_eye<eye>(eyes, centre, optical).rotation, radius, lid);
    set_lid_numbers(eyes.lid_shadow.data() + lid_numbers * e, lid);
}

/// Places the lid of an eye and darkens its features, those of both eyes in the columns of `g` from
/// `begin` on; nothing without shadows. points: both eyes', as pupils moved them, 3 x P.
template <std::size_t eye, class T, EffectSet E, Backend B, class Lids>
void shade_eye([[maybe_unused]] const B& backend, [[maybe_unused]] const EyeStream<T, E>& eyes,
               [[maybe_unused]] const Vec3<T>& centre,
               [[maybe_unused]] const OpticalDrivers<T, E>& optical,
               [[maybe_unused]] const T* points, [[maybe_unused]] Lids& lids,
               [[maybe_unused]] Gaussians<T>& g, [[maybe_unused]] Index begin) {
    if constexpr (has_effect<E, LidShadow>) {
        if (!eyes.has_lid_shadow()) return;
        place_lid<eye>(eyes, centre, optical, lids);
        lids.plain.resize(shaded_channels, eyes.position.cols());
        const Index first = eyes.first_point(static_cast<Index>(eye)), channels = g.feature.rows();
        for_each(backend, eyes.points_of(static_cast<Index>(eye)),
                 ShadeEyePoint<T>{points + 3 * first, &lids.eye[eye], channels,
                                  g.feature.data() + channels * (begin + first),
                                  lids.plain.data() + shaded_channels * first});
    }
}

/// Destinations of eye_lids_vjp: cotangents of the features of both eyes' points (columns from
/// `begin` on), which it takes to those before the shadow, and of the means of the face, head
/// frame; and gradients that it adds to.
template <class T, EffectSet E>
struct LidGradients {
    Gaussians<T>& gaussians;
    Index begin;
    EyeStream<T, E>& eyes;
    Columns<T>& rest; ///< the face's positions at rest
    LidsCotangent<T>& places;
};

/// Accumulates the gradients of the lids' numbers and of the lids' points, and gives what the
/// shadows add to the cotangents of the eyes' places. points: both eyes', as pupils moved them.
template <class T, EffectSet E, Backend B>
    requires has_effect<E, LidShadow>
void eye_lids_vjp(const B& backend, const EyeStream<T, E>& eyes, const FrameLids<T>& lids,
                  const Columns<T>& points, const std::type_identity_t<LidGradients<T, E>>& to) {
    if (!eyes.has_lid_shadow()) return;
    Gaussians<T>& g = to.gaussians;
    const Index channels = g.feature.rows();
    for (std::size_t eye = 0; eye < 2; ++eye) {
        const Index e = static_cast<Index>(eye), first = eyes.first_point(e);
        T* const g_feature = g.feature.data() + channels * (to.begin + first);
        const auto sums = sum_each(
            backend, eyes.points_of(e),
            ShadeEyePointVjp<T>{points.data() + 3 * first, &lids.eye[eye], channels,
                                lids.plain.data() + shaded_channels * first, g_feature, g_feature});
        lid_numbers_vjp(eyes.lid_shadow.data() + lid_numbers * e, sums,
                        to.eyes.lid_shadow.data() + lid_numbers * e);
        const T radius = eyeball_radius(eyes, e);
        to.places.turn[eye] += lid_turn_vjp(sums, radius);
        const Columns<T> at = lids.around(eye, radius);
        for (Index k = 0; k < at.cols(); ++k) {
            Vec2<T> own(T(0), T(0));
            LidArc<T>{at.data(), at.cols()}.vjp(k, sums.begin() + LidSums::height_at, own.data());
            own /= radius;
            const Index i = lid_column(eyes.lid_line, e * at.cols() + k);
            g.mean.col(i).template head<2>() += own;
            to.rest.col(i).template head<2>() -= own;
            to.places.centre.col(e).template head<2>() -= own;
        }
    }
}

/// Returns true if two lids have the same bits.
template <Real T>
bool same_lid(const LidOfEye<T>& a, const LidOfEye<T>& b) {
    bool same = rye::same_bits(a.across, b.across) && rye::same_bits(a.up, b.up) &&
                rye::same_bits(a.strength, b.strength) && rye::same_bits(a.width, b.width) &&
                rye::same_bits(a.offset, b.offset);
    for (std::size_t k = 0; k < a.height.size(); ++k)
        same = same && rye::same_bits(a.height[k], b.height[k]);
    return same;
}

} // namespace detail

} // namespace rye
