// SPDX-License-Identifier: Apache-2.0
/// rye/train/lid_line.hpp: places along the lines of the upper lids, and the Gaussians of a face
/// that carry them, for the effect LidShadow (rig/lid_shadow.hpp), found at rest by the landmarks
/// around the eyes. Head frame, canonical units.
#pragma once

#include <algorithm>
#include <array>
#include <vector>

#include <rye/avatar/eye_lids.hpp>
#include <rye/avatar/two_stream.hpp>

namespace rye {

/// Places along each upper lid's line.
inline constexpr Index lid_line_points = 16;

/// Numbers of a shadow before training: a tenth of the light on the line, and a width of 0.3 radii.
inline constexpr std::array<double, 3> first_lid_shadow{-2.2, -1.2, 0};

namespace detail {

/// Returns the landmarks of an eye that are on its upper lid: the corners, which are the outermost
/// in x, and those above the chord between them, by x; 3 x K. Empty without one above it.
template <Real T>
Columns<T> upper_lid(const Columns<T>& landmarks, const std::vector<Index>& eye) {
    std::vector<Vec3<T>> points;
    for (const Index k : eye) points.push_back(landmarks.col(k));
    std::stable_sort(points.begin(), points.end(),
                     [](const Vec3<T>& a, const Vec3<T>& b) { return a.x() < b.x(); });
    std::vector<Vec3<T>> upper;
    for (const Vec3<T>& p : points) {
        const Vec3<T> chord = points.back() - points.front(), from = p - points.front();
        const bool corner = &p == &points.front() || &p == &points.back();
        if (corner || from.y() * chord.x() > chord.y() * from.x()) upper.push_back(p);
    }
    if (upper.size() < 3) return {};
    Columns<T> line(3, static_cast<Index>(upper.size()));
    for (std::size_t k = 0; k < upper.size(); ++k) line.col(static_cast<Index>(k)) = upper[k];
    return line;
}

/// Returns `count` points of a lid, evenly apart in x from corner to corner, as far from the eye's
/// centre as the landmarks beside them.
template <Real T>
Columns<T> along_lid(const Columns<T>& lid, const Vec3<T>& centre, Index count) {
    Columns<T> at(3, count);
    const T first = lid(0, 0), width = lid(0, lid.cols() - 1) - first;
    Index k = 0;
    for (Index i = 0; i < count; ++i) {
        const T x = first + width * T(i) / T(count - 1);
        while (k + 2 < lid.cols() && lid(0, k + 1) < x) ++k;
        const T apart = lid(0, k + 1) - lid(0, k),
                share = apart > T(0) ? std::clamp((x - lid(0, k)) / apart, T(0), T(1)) : T(0);
        const Vec3<T> a = lid.col(k) - centre, b = lid.col(k + 1) - centre,
                      between = a + share * (b - a);
        const T length = between.norm(), far = a.norm() + share * (b.norm() - a.norm());
        at.col(i) = centre + (length > T(0) ? T(far / length) : T(1)) * between;
    }
    return at;
}

} // namespace detail

/// Gives the avatar shadows of its upper lids, before training; returns false, and changes nothing,
/// if an eye has no landmarks of an upper lid, or the face fewer than lid_line_points Gaussians.
/// A place is carried by the Gaussian that is nearest at rest, none carries two of a lid.
template <Real T, EffectSet E>
    requires has_effect<E, LidShadow>
bool begin_lid_shadow(TwoStream<T, E>& avatar, const LandmarkRoles& roles) {
    const FaceStream<T, E>& face = avatar.face;
    const Index n = face.position.cols();
    if (n < lid_line_points) return false;
    Columns<T> line(3, 2 * lid_line_points);
    for (Index eye = 0; eye < 2; ++eye) {
        const std::vector<Index>& around = roles.eye[static_cast<std::size_t>(eye)];
        if (around.empty() || face.landmarks.cols() == 0) return false;
        const Columns<T> lid = detail::upper_lid(face.landmarks, around);
        if (lid.cols() == 0) return false;
        const Columns<T> at =
            detail::along_lid<T>(lid, avatar.eyes.centre.col(eye), lid_line_points);
        std::vector<bool> taken(static_cast<std::size_t>(n), false);
        for (Index k = 0; k < lid_line_points; ++k) {
            Index nearest = -1;
            T least = T(0);
            for (Index i = 0; i < n; ++i) {
                const T apart = (face.position.col(i) - at.col(k)).squaredNorm();
                if (!taken[static_cast<std::size_t>(i)] && (nearest < 0 || apart < least)) {
                    nearest = i;
                    least = apart;
                }
            }
            taken[static_cast<std::size_t>(nearest)] = true;
            line.col(eye * lid_line_points + k) << static_cast<T>(nearest), at(0, k), at(1, k);
        }
    }
    avatar.eyes.lid_line = line;
    avatar.eyes.lid_shadow.resize(lid_numbers, 2);
    for (Index k = 0; k < lid_numbers; ++k)
        avatar.eyes.lid_shadow.row(k).setConstant(
            static_cast<T>(first_lid_shadow[static_cast<std::size_t>(k)]));
    return true;
}

namespace detail {

/// Follows a change of the face's Gaussians: `whole` has the column before of each after it,
/// ascending; the nearest one that is left carries on for one that is gone. position: before, 3 x
/// N.
template <Real T>
void follow_lid_line(const Columns<T>& position, const std::vector<Index>& whole,
                     Columns<T>& line) {
    for (Index k = 0; k < line.cols(); ++k) {
        const Index i = lid_column(line, k);
        auto found = std::lower_bound(whole.begin(), whole.end(), i);
        if (found == whole.end() || *found != i) {
            const auto apart = [&](Index j) {
                return (position.col(j) - position.col(i)).squaredNorm();
            };
            found = std::min_element(whole.begin(), whole.end(),
                                     [&](Index a, Index b) { return apart(a) < apart(b); });
        }
        line(0, k) = static_cast<T>(found - whole.begin());
    }
}

} // namespace detail

} // namespace rye
