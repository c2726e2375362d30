// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/view_color.hpp: colours that depend on where a Gaussian is seen from. To its first
/// three channels
///     sum of c_k Y_k(v) over bands 1 to a degree of 1 to 3
/// is added: v is the unit direction from the camera's centre to its mean, turned into the head's
/// frame, Y_k are those of math/harmonics.hpp. Eyes have the head's frame too: an eyeball's front
/// turns under lights that stay. A Gaussian at the camera has no direction, and gets nothing.
/// HeadShading multiplies what this gives as the rest of a colour. Not in the paper.
/// Source of the formula: 3D Gaussian Splatting, Kerbl et al. 2023, without its constant band.
#pragma once

#include <rye/avatar/drivers.hpp>
#include <rye/backend/each.hpp>
#include <rye/core/column_array.hpp>
#include <rye/core/error.hpp>
#include <rye/core/fields.hpp>
#include <rye/gaussian/gaussians.hpp>
#include <rye/math/harmonics.hpp>

namespace rye {

/// Coefficients of the Gaussians' colours: K for red, then green, then blue; K is 3, 8 or 15.
/// Without any (default-constructed) colours are the same from everywhere.
template <class T>
struct ViewColors {
    Columns<T> face; ///< of the face's Gaussians, 3K x N
    Columns<T> eyes; ///< of both eyeballs', the left one's first, 3K x P

    RYE_HD bool any() const { return face.rows() > 0; }

    template <class F, class... P>
    static void fields(F&& f, P&&... p) {
        if (!(p.any() || ...)) return;
        f("face", p.face...);
        f("eyes", p.eyes...);
    }
};

/// Numbers of a Gaussian for colours of a degree, 3K.
RYE_HD constexpr Index view_color_numbers(int degree) { return 3 * Index(sh_count(degree) - 1); }

/// Colours of a degree, 1 to 3, that change nothing yet.
template <class T>
ViewColors<T> initial_view_colors(int degree, Index face, Index eyes) {
    const Index rows = view_color_numbers(degree);
    return {Columns<T>::Zero(rows, face), Columns<T>::Zero(rows, eyes)};
}

namespace detail {

/// Calls f(std::integral_constant<int, degree>) for colours of 3K numbers a Gaussian. Throws an
/// Error for another number than those of degrees 1 to 3.
template <class F>
void with_view_degree(Index rows, F&& f) {
    if (rows == view_color_numbers(1)) return f(std::integral_constant<int, 1>{});
    if (rows == view_color_numbers(2)) return f(std::integral_constant<int, 2>{});
    if (rows == view_color_numbers(3)) return f(std::integral_constant<int, 3>{});
    throw Error("view_color: got " + std::to_string(rows) +
                " coefficients a Gaussian, expected 9, 24 or 45");
}

/// A head before a camera.
template <class T>
struct SeenHead {
    Vec3<T> camera;   ///< its centre, world
    Mat3<T> rotation; ///< of the head, to the world
};

/// A Gaussian before a camera: where it is, and the harmonics of its direction.
template <class T, int degree>
struct ViewedPoint {
    static constexpr int more = sh_count(degree) - 1;
    Vec3<T> away;   ///< mean - camera, world
    Vec3<T> offset; ///< the same in the head's frame
    ShArray<T, degree> basis;

    RYE_HD ViewedPoint(const Vec3<T>& mean, const SeenHead<T>& seen)
        : away(mean - seen.camera),
          offset(seen.rotation.transpose() * away),
          basis(sh_basis<T, degree>(normalized(offset))) {}

    /// What is added to channel c. `own`: the Gaussian's coefficients.
    RYE_HD T channel(const T* own, int c) const {
        T sum = basis[1] * own[c * more];
        for (int k = 1; k < more; ++k) sum += basis[std::size_t(k + 1)] * own[c * more + k];
        return sum;
    }
    /// Returns the cotangent of `offset`; adds that of the coefficients.
    RYE_HD Vec3<T> vjp(const Vec3<T>& g, const T* own, T* g_own) const {
        ShArray<T, degree> g_basis;
        for (T& b : g_basis) b = T(0);
        for (int c = 0; c < 3; ++c)
            for (int k = 0; k < more; ++k) {
                g_basis[std::size_t(k + 1)] += own[c * more + k] * g[c];
                g_own[c * more + k] += basis[std::size_t(k + 1)] * g[c];
            }
        return normalized_vjp(offset, sh_basis_vjp<T, degree>(normalized(offset), g_basis));
    }
};

/// Adds its colour to Gaussian i of a cloud, or of some of its columns.
template <class T, int degree>
struct AddViewColor {
    static constexpr const char* name = "colours by the view";
    static constexpr Index numbers = view_color_numbers(degree);
    const T* coefficients; ///< 3K x N
    const Index* of;       ///< the column of Gaussian i there; null: i
    const T* mean;         ///< world, 3 x n
    SeenHead<T> seen;
    Index channels;
    T* feature; ///< channels x n

    RYE_HD void add(Index i, const T* own) const {
        const ViewedPoint<T, degree> point(column3(mean, i), seen);
        for (int c = 0; c < 3; ++c) feature[i * channels + c] += point.channel(own, c);
    }
    RYE_HD void operator()(Index i) const {
        add(i, coefficients + numbers * (of == nullptr ? i : of[i]));
    }
};

/// Its vjp: adds the cotangents of Gaussian i's mean and coefficients; sums that of the head's
/// rotation, column by column.
template <class T, int degree>
struct AddViewColorVjp {
    using Number = T;
    static constexpr const char* name = "colours by the view, reverse";
    static constexpr int sums = 9;
    const T* mean; ///< world, 3 x n
    SeenHead<T> seen;
    Index channels;
    const T* g_feature; ///< channels x n
    T* g_mean;          ///< 3 x n, added to

    template <class Sums>
    RYE_HD void add(Index i, const T* own, T* g_own, Sums& sum) const {
        const ViewedPoint<T, degree> point(column3(mean, i), seen);
        const T* const g = g_feature + i * channels;
        const Vec3<T> g_offset = point.vjp(Vec3<T>(g[0], g[1], g[2]), own, g_own);
        const Vec3<T> g_away = seen.rotation * g_offset;
        add_column<3>(g_away, g_mean, i);
        for (int c = 0; c < 3; ++c)
            for (int r = 0; r < 3; ++r) sum[std::size_t(3 * c + r)] += point.away[r] * g_offset[c];
    }
};

/// The same with the arrays of coefficients.
template <class T, int degree>
struct AddViewColorsVjp {
    using Number = T;
    static constexpr int sums = AddViewColorVjp<T, degree>::sums;
    AddViewColorVjp<T, degree> point;
    const T* coefficients;
    T* g_coefficients; ///< added to

    template <class Sums>
    RYE_HD void operator()(Index i, Sums& sum) const {
        const Index at = view_color_numbers(degree) * i;
        point.add(i, coefficients + at, g_coefficients + at, sum);
    }
};

/// Coefficients of some Gaussians: those of columns `of`, or of all from the first on if null.
template <class T>
struct ColorColumns {
    const T* data;
    Index rows; ///< 3K
    const Index* of;
};

/// Adds their colours to a cloud's columns.
template <class T, Backend B>
void add_view_color(const B& backend, const std::type_identity_t<ColorColumns<T>>& from,
                    const SeenHead<T>& seen, const ColumnRange& range, Gaussians<T>& g) {
    const Index rows = g.feature.rows();
    with_view_degree(from.rows, [&](auto degree) {
        for_each(backend, range.count,
                 AddViewColor<T, degree()>{from.data, from.of, g.mean.data() + 3 * range.begin,
                                           seen, rows, g.feature.data() + rows * range.begin});
    });
}

/// Returns the head before the frame's camera. Throws an Error if nobody has set the camera.
template <class T, EffectSet E, class... Head>
SeenHead<T> seen_head_of(const Drivers<T, E>& drivers, const Head&... head) {
    require_camera(drivers.camera, "view_color");
    SeenHead<T> seen{drivers.camera, Mat3<T>::Identity()};
    ((seen.rotation = head.rotation), ...);
    return seen;
}

} // namespace detail

/// Adds the colours of a driven cloud, the face's N Gaussians first, as `seen`.
template <class T, Backend B>
void add_view_colors(const B& backend, const ViewColors<T>& colors,
                     const std::type_identity_t<detail::SeenHead<T>>& seen, Gaussians<T>& g) {
    const Index n = colors.face.cols();
    RYE_ASSERT(n + colors.eyes.cols() == g.count(), "add_view_colors: another number of points");
    const auto part = [&](const Columns<T>& from, Index begin) {
        detail::add_view_color(backend, {from.data(), from.rows(), nullptr}, seen,
                               {begin, from.cols()}, g);
    };
    part(colors.face, 0);
    part(colors.eyes, n);
}

/// Adds the cotangents of the cloud's means and of the coefficients, given the features'. Returns
/// that of the head's rotation. `g`: of the cloud whose means are `mean`.
template <class T, Backend B>
Mat3<T> view_colors_vjp(const B& backend, const ViewColors<T>& colors,
                        const std::type_identity_t<detail::SeenHead<T>>& seen,
                        const Columns<T>& mean, Gaussians<T>& g, ViewColors<T>& grad) {
    Mat3<T> g_rotation = Mat3<T>::Zero();
    const auto part = [&](const Columns<T>& from, Columns<T>& to, Index begin) {
        const Index rows = g.feature.rows();
        detail::with_view_degree(from.rows(), [&](auto degree) {
            using Sums = detail::AddViewColorsVjp<T, degree()>;
            const detail::SumsOf<Sums> sums =
                detail::sum_each(backend, from.cols(),
                                 Sums{{mean.data() + 3 * begin, seen, rows,
                                       g.feature.data() + rows * begin, g.mean.data() + 3 * begin},
                                      from.data(),
                                      to.data()});
            for (std::size_t k = 0; k < 9; ++k) g_rotation.data()[k] += sums[k];
        });
    };
    part(colors.face, grad.face, 0);
    part(colors.eyes, grad.eyes, colors.face.cols());
    return g_rotation;
}

} // namespace rye
