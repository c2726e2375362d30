// SPDX-License-Identifier: Apache-2.0
/// rye/train/lid_margin.hpp: lines of the lids by the landmarks around the eyes, and points along
/// them where Gaussians of the face are to begin: the wet margins, in rows along each line, and the
/// caruncle, between both lids at the corner by the nose. The face's fields drive these as they do
/// the skin beside them. Any frame of landmarks; distances in its units.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include <rye/core/columns.hpp>
#include <rye/core/concepts.hpp>
#include <rye/io/capture.hpp>
#include <rye/math/linalg.hpp>

namespace rye {

/// The lids of an eye (0: the subject's left), each from its corner by the nose to the outer one.
template <class T>
struct LidLines {
    Columns<T> upper, lower; ///< 3 x N
};

namespace detail {

/// Returns points of a smooth line through others (3 x K, K > 1; Catmull and Rom's), as far apart
/// along it as `spacing` or a little less, from the first to the last.
template <Real T>
Columns<T> smooth_line(const Columns<T>& through, std::type_identity_t<T> spacing) {
    constexpr Index fine = 32; // pieces between two of the points
    const Index k = through.cols();
    std::vector<Vec3<T>> at;
    std::vector<T> length{T(0)};
    for (Index i = 0; i + 1 < k; ++i)
        for (Index j = i == 0 ? 0 : 1; j <= fine; ++j) {
            const Vec3<T> a = through.col(i), b = through.col(i + 1);
            const Vec3<T> from = i > 0 ? Vec3<T>((b - Vec3<T>(through.col(i - 1))) / T(2))
                                       : Vec3<T>(b - a),
                          to = i + 2 < k ? Vec3<T>((Vec3<T>(through.col(i + 2)) - a) / T(2))
                                         : Vec3<T>(b - a);
            const T t = T(j) / T(fine), u = T(1) - t;
            at.push_back((T(1) + T(2) * t) * u * u * a + t * u * u * from +
                         t * t * (T(3) - T(2) * t) * b - t * t * u * to);
            if (at.size() > 1)
                length.push_back(length.back() + (at.back() - at[at.size() - 2]).norm());
        }
    const Index pieces = std::max<Index>(1, static_cast<Index>(std::ceil(length.back() / spacing)));
    Columns<T> line(3, pieces + 1);
    std::size_t next = 1;
    for (Index i = 0; i <= pieces; ++i) {
        const T wanted = length.back() * T(i) / T(pieces);
        while (next + 1 < at.size() && length[next] < wanted) ++next;
        const T piece = length[next] - length[next - 1];
        const T share =
            piece > T(0) ? std::clamp((wanted - length[next - 1]) / piece, T(0), T(1)) : T(0);
        line.col(i) = at[next - 1] + share * (at[next] - at[next - 1]);
    }
    return line;
}

} // namespace detail

/// Returns the lids of an eye by its six landmarks, columns of 66 or more in the capture's order.
template <Real T>
LidLines<T> lid_lines(const Columns<T>& landmarks, int eye, std::type_identity_t<T> spacing) {
    const std::array<int, 6> k = eye_landmarks(eye);
    // Around the eye from the corner on the image's left, by the upper lid: of the left eye that is
    // the corner by the nose.
    const std::array<int, 4> upper = eye == 0 ? std::array{k[0], k[1], k[2], k[3]}
                                              : std::array{k[3], k[2], k[1], k[0]},
                             lower = eye == 0 ? std::array{k[0], k[5], k[4], k[3]}
                                              : std::array{k[3], k[4], k[5], k[0]};
    const auto line = [&](const std::array<int, 4>& which) {
        Columns<T> through(3, 4);
        for (std::size_t i = 0; i < 4; ++i)
            through.col(static_cast<Index>(i)) = landmarks.col(which[i]);
        return detail::smooth_line<T>(through, spacing);
    };
    return {line(upper), line(lower)};
}

/// Rows along a lid's line, and how far the caruncle reaches from the corner.
inline constexpr Index lid_margin_rows = 3;
inline constexpr double caruncle_length = 0.05; ///< [canonical unit]

namespace detail {

/// Returns rows along a lid: the middle one on its line, the others beside it, away from the other
/// lid and toward it, not beyond a third of the way to it. centre: of the eyeball.
template <Real T>
Columns<T> lid_rows(const Columns<T>& lid, const Columns<T>& other, const Vec3<T>& centre,
                    T spacing) {
    const Index n = lid.cols();
    Columns<T> rows(3, lid_margin_rows * n);
    for (Index i = 0; i < n; ++i) {
        const Vec3<T> p = lid.col(i), out = p - centre,
                      along = lid.col(std::min(i + 1, n - 1)) - lid.col(std::max<Index>(i - 1, 0));
        Index nearest = 0;
        const T apart = std::sqrt((other.colwise() - p).colwise().squaredNorm().minCoeff(&nearest));
        Vec3<T> across = cross(out, along);
        const T length = across.norm();
        across = length > T(0) ? Vec3<T>(across / length) : Vec3<T>(0, 1, 0);
        // Toward the other lid as it is in the middle: at a corner both meet.
        if (across.dot(Vec3<T>(other.col(other.cols() / 2) - lid.col(n / 2))) < T(0))
            across = -across;
        for (Index row = 0; row < lid_margin_rows; ++row) {
            const T step = spacing * T(row - lid_margin_rows / 2);
            rows.col(row * n + i) = p + std::min(step, apart / T(3)) * across;
        }
    }
    return rows;
}

/// Returns points between both lids where they are less than caruncle_length from the corner by the
/// nose, without those on the lines.
template <Real T>
Columns<T> caruncle(const LidLines<T>& lids, T spacing) {
    std::vector<Vec3<T>> points;
    const Vec3<T> corner = lids.upper.col(0);
    for (Index i = 1; i < std::min(lids.upper.cols(), lids.lower.cols()); ++i) {
        const Vec3<T> from = lids.upper.col(i), to = lids.lower.col(i);
        if ((T(0.5) * (from + to) - corner).norm() >= T(caruncle_length)) break;
        const auto pieces = static_cast<Index>(std::ceil((to - from).norm() / spacing));
        for (Index k = 1; k < pieces; ++k)
            points.push_back(from + (T(k) / T(pieces)) * (to - from));
    }
    Columns<T> all(3, static_cast<Index>(points.size()));
    for (std::size_t i = 0; i < points.size(); ++i) all.col(static_cast<Index>(i)) = points[i];
    return all;
}

} // namespace detail

/// Points on the margins of both eyes' lids and on the caruncles: the left eye's first, of each eye
/// the upper lid's, the lower lid's and the caruncle's.
template <class T>
struct LidMargin {
    Columns<T> points; ///< 3 x N
    Index left = 0;    ///< how many are the left eye's

    Index points_of(Index eye) const { return eye == 0 ? left : points.cols() - left; }
};

/// Returns points `spacing` apart. landmarks: 66 or more in the capture's order; centre: of the
/// eyeballs, 3 x 2.
template <Real T>
LidMargin<T> lid_margin_points(const Columns<T>& landmarks, const Columns<T>& centre,
                               std::type_identity_t<T> spacing) {
    LidMargin<T> margin{Columns<T>(3, 0), 0};
    Columns<T>& all = margin.points;
    for (int eye = 0; eye < 2; ++eye) {
        const LidLines<T> lids = lid_lines<T>(landmarks, eye, spacing);
        const Vec3<T> middle = centre.col(eye);
        for (const Columns<T>& part : {detail::lid_rows<T>(lids.upper, lids.lower, middle, spacing),
                                       detail::lid_rows<T>(lids.lower, lids.upper, middle, spacing),
                                       detail::caruncle<T>(lids, spacing)}) {
            Columns<T> more(3, all.cols() + part.cols());
            more << all, part;
            all = std::move(more);
        }
        if (eye == 0) margin.left = all.cols();
    }
    return margin;
}

} // namespace rye
