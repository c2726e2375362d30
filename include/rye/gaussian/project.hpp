// SPDX-License-Identifier: Apache-2.0
/// rye/gaussian/project.hpp: projection of a 3D Gaussian to a 2D one, to first order in depth.
/// Camera frame x right, y down, z forward; screen positions are offsets from the principal point
/// [px], so that a crop of an image gives the same numbers as the image.
/// Source: Zwicker et al., "EWA Splatting", 2002, eq. 26-31. Covariances are never formed from
/// their entries: the factor M = J W R S (2 x 3) is kept, Sigma = M M^T + d I.
/// A lens with distortion D(s) of slopes s (geometry/distortion.hpp) distorts the mean, and J is
/// the Jacobian of the distorted projection, diag(f) D'(s) ds/dx, to first order. The error of the
/// centre is D'' times the variance of the slopes; tests/gaussian/distortion_test.cpp measures it.
#pragma once

#include <type_traits>

#include <rye/gaussian/antialias.hpp>
#include <rye/geometry/camera.hpp>
#include <rye/math/rotation.hpp>

namespace rye {

namespace detail {

/// r^2 at the fold of a lens with distortion; empty without.
template <Scalar T, class D>
struct LensReach {
    T fold;
};
template <Scalar T>
struct LensReach<T, NoDistortion> {};

} // namespace detail

/// Constants of the projection: a camera, the limits of the Jacobian, the dilation.
template <Scalar T, Distortion D = NoDistortion>
struct Projector {
    Rigid<T> camera_from_world;
    T fx, fy;                    ///< focal lengths [px]
    T x_low, x_high;             ///< limits of x/z inside the Jacobian
    T y_low, y_high;             ///< limits of y/z inside the Jacobian
    T near_depth;                ///< [world units]
    T dilation;                  ///< d, added to both variances [px^2]
    [[no_unique_address]] D distortion = {};
    [[no_unique_address]] detail::LensReach<T, D> reach = {};

    /// Slopes in the Jacobian are clamped to `margin` half-images beyond the border, wherever the
    /// principal point is; otherwise splats beside the image would grow without bound.
    RYE_HD Projector(const Pinhole<T, D>& c, double margin, double dilation_px2)
        : camera_from_world(c.camera_from_world), fx(c.fx), fy(c.fy), near_depth(c.near_depth),
          dilation(T(dilation_px2)), distortion(c.distortion) {
        const T half_x = T(0.5 * c.width * margin), half_y = T(0.5 * c.height * margin);
        x_low = (-c.cx - half_x) / fx;
        x_high = (T(c.width) - c.cx + half_x) / fx;
        y_low = (-c.cy - half_y) / fy;
        y_high = (T(c.height) - c.cy + half_y) / fy;
        if constexpr (D::distorts) {
            reach.fold = T(distortion.fold());
            undistort_limits();
        }
    }

    /// The same lens in every lane of a batch.
    template <Scalar U, Distortion O>
        requires(O::distorts == D::distorts)
    RYE_HD explicit Projector(const Projector<U, O>& o)
        : fx(o.fx), fy(o.fy), x_low(o.x_low), x_high(o.x_high), y_low(o.y_low), y_high(o.y_high),
          near_depth(o.near_depth), dilation(o.dilation),
          distortion(o.distortion.template cast<T>()) {
        if constexpr (D::distorts) reach.fold = T(o.reach.fold);
        for (int i = 0; i < 9; ++i)
            camera_from_world.rotation.data()[i] = T(o.camera_from_world.rotation.data()[i]);
        for (int i = 0; i < 3; ++i)
            camera_from_world.translation[i] = T(o.camera_from_world.translation[i]);
    }

  private:
    /// Turns limits of distorted slopes into limits of slopes: the bounding box of the undistorted
    /// border, with points that no slope reaches moved to the fold.
    RYE_HD void undistort_limits() {
        const T lows[2] = {x_low, y_low}, highs[2] = {x_high, y_high};
        T box[4] = {T(0), T(0), T(0), T(0)};                              // low x, y, high x, y
        bool first = true;
        for (int i = 0; i < 9; ++i) {
            if (i == 4) continue;
            const auto at = [&](int k, int third) {
                return third == 0   ? lows[k]
                       : third == 2 ? highs[k]
                                    : T(constant<T>(0.5) * (lows[k] + highs[k]));
            };
            Vec2<T> s(at(0, i % 3), at(1, i / 3));
            const Undistorted<T> u = undistort(distortion, s);
            if (u.reached) {
                s = u.slope;
            } else {
                using std::sqrt;
                const T shrink = sqrt(reach.fold / dot(s, s));
                if (shrink < T(1)) s = Vec2<T>(s[0] * shrink, s[1] * shrink);
            }
            for (int k = 0; k < 2; ++k) {
                box[k] = first ? s[k] : T(min(box[k], s[k]));
                box[2 + k] = first ? s[k] : T(max(box[2 + k], s[k]));
            }
            first = false;
        }
        x_low = box[0], y_low = box[1], x_high = box[2], y_high = box[3];
    }
};
template <Scalar T, Distortion D>
Projector(const Pinhole<T, D>&, double, double) -> Projector<T, D>;

/// Position and shape in the world; also their cotangents.
template <Scalar T>
struct Shape {
    Vec3<T> mean;                ///< [world units]
    Quat<T> rotation;            ///< any norm; 0: identity
    Vec3<T> scale;               ///< [world units]
};

/// A Gaussian on the screen.
template <Scalar T>
struct ScreenGaussian {
    using Mask = decltype(std::declval<const T&>() < std::declval<const T&>());

    Vec2<T> centre;              ///< from the principal point [px]
    T depth;                     ///< z [world units]
    Sym2<T> covariance;          ///< for bounds [px^2]
    T determinant;               ///< covariance's determinant [px^4]
    detail::PrecisionFactor<T> precision; ///< w = L (p - centre), density exp(-|w|^2 / 2)
    Mask drawable;               ///< beyond the near plane, with a finite ellipse
};

namespace detail {

/// A Gaussian on the screen whose opacity is multiplied by a share (Antialias::mip).
template <Scalar T>
struct MipGaussian : ScreenGaussian<T> {
    T share;                     ///< in [0, 1]
};

} // namespace detail

/// Result of project.
template <Scalar T, Antialias how>
using Projected =
    std::conditional_t<how == Antialias::mip, detail::MipGaussian<T>, ScreenGaussian<T>>;

namespace detail {

/// Returns the opacity that is rendered.
template <Scalar T>
RYE_HD T kept_opacity(const ScreenGaussian<T>&, const T& opacity) {
    return opacity;
}
/// Returns the opacity times the share.
template <Scalar T>
RYE_HD T kept_opacity(const MipGaussian<T>& s, const T& opacity) {
    return opacity * s.share;
}

} // namespace detail

/// Cotangent of a screen Gaussian. The shape's is in whitened offsets w = L (p - centre): `moment`
/// is the sum of g w w^T over pixels, g being the cotangent of -|w|^2 / 2. In these terms there is
/// no cancellation, however thin the needle.
template <Scalar T>
struct ScreenCotangent {
    Vec2<T> centre;              ///< [1 / px]
    Sym2<T> moment;
    T depth;
};

namespace detail {

/// D' at the slope of the Jacobian, and D at the point; empty for a lens without distortion.
template <Scalar T, class D>
struct DistortedSlopes {
    Distorted<T> here, limited;
    Vec2<T> place;               ///< slope at which `limited` is taken
};
template <Scalar T>
struct DistortedSlopes<T, NoDistortion> {};

/// Intermediate values of projection and its vjp: y = W x + t, rows of J W R (before scaling).
template <Scalar T, class D = NoDistortion>
struct Linearised {
    using Mask = typename ScreenGaussian<T>::Mask;
    Vec3<T> point;               ///< in the camera [world units]
    Mask in_front;
    T inverse_depth;
    T slope_x, slope_y;          ///< x/z and y/z
    Mask free_x, free_y;         ///< the slope is within its limits
    Vec3<T> toward_x, toward_y;  ///< rows of J W [px / world unit]
    Mat3<T> axes;                ///< R
    Vec3<T> along_x, along_y;    ///< rows of J W R
    [[no_unique_address]] DistortedSlopes<T, D> bent;

    RYE_HD Linearised(const Shape<T>& g, const Projector<T, D>& lens)
        : point(lens.camera_from_world.apply(g.mean)), in_front(point[2] > lens.near_depth),
          inverse_depth(T(1) / select(in_front, point[2], T(1))),
          slope_x(point[0] * inverse_depth), slope_y(point[1] * inverse_depth),
          free_x((slope_x >= lens.x_low) && (slope_x <= lens.x_high)),
          free_y((slope_y >= lens.y_low) && (slope_y <= lens.y_high)),
          axes(quat_matrix(quat_normalized(g.rotation))) {
        const T x = select(slope_x < lens.x_low, lens.x_low,
                           select(slope_x > lens.x_high, lens.x_high, slope_x));
        const T y = select(slope_y < lens.y_low, lens.y_low,
                           select(slope_y > lens.y_high, lens.y_high, slope_y));
        const Mat3<T>& w = lens.camera_from_world.rotation;
        const T px = lens.fx * inverse_depth, py = lens.fy * inverse_depth;
        for (int i = 0; i < 3; ++i) {
            toward_x[i] = px * (w(0, i) - x * w(2, i));
            toward_y[i] = py * (w(1, i) - y * w(2, i));
        }
        if constexpr (D::distorts) {
            const Vec2<T> here(slope_x, slope_y);
            bent.place = Vec2<T>(x, y);
            bent.here = lens.distortion.distort(here);
            bent.limited = lens.distortion.distort(bent.place);
            in_front = in_front && within_lens(here, bent.here.slope, lens.reach.fold);
            const Sym2<T>& j = bent.limited.slope;
            for (int i = 0; i < 3; ++i) {
                const T right = w(0, i) - x * w(2, i), down = w(1, i) - y * w(2, i);
                toward_x[i] = px * (j.xx * right + j.xy * down);
                toward_y[i] = py * (j.xy * right + j.yy * down);
            }
        }
        for (int i = 0; i < 3; ++i) {
            const Vec3<T> axis = axes.col(i);
            along_x[i] = dot(toward_x, axis);
            along_y[i] = dot(toward_y, axis);
        }
    }
};

template <Scalar T>
RYE_HD Vec3<T> scaled_by(const Vec3<T>& a, const Vec3<T>& s) {
    return Vec3<T>(a[0] * s[0], a[1] * s[1], a[2] * s[2]);
}

/// Returns the second row of L M, k2 (y - m x), of the rows x = S A and y = S B of M, A and B being
/// the rows of J W R and S the scales. Along a needle that difference cancels, and with it the
/// gradient of the needle's rotation; a (y - m x) = S (d B + (A x B) x S^2 A) has no such
/// difference.
template <Scalar T, class D>
RYE_HD Vec3<T> whitened_second_row(const Linearised<T, D>& l, const Vec3<T>& scale,
                                   const PrecisionFactor<T>& f, const T& d) {
    const Vec3<T> x = scaled_by(l.along_x, scale);
    const Vec3<T> turned = cross(cross(l.along_x, l.along_y), scaled_by(x, scale));
    const T k = f.k2 / (dot(x, x) + d);
    Vec3<T> v;
    for (int i = 0; i < 3; ++i) v[i] = k * (scale[i] * (d * l.along_y[i] + turned[i]));
    return v;
}

} // namespace detail

/// Returns a Gaussian on the screen. Batches evaluate every lane; only lanes with `drawable` have
/// meaningful values.
template <Antialias how = Antialias::dilate, Scalar T, Distortion D>
RYE_HD Projected<T, how> project(const Shape<T>& g, const Projector<T, D>& lens) {
    const detail::Linearised<T, D> l(g, lens);
    const Vec3<T> x = detail::scaled_by(l.along_x, g.scale);              // rows of M [px]
    const Vec3<T> y = detail::scaled_by(l.along_y, g.scale);
    Projected<T, how> s;
    if constexpr (how == Antialias::mip) s.share = dilation_share(x, y, lens.dilation);
    s.centre = Vec2<T>(lens.fx * l.slope_x, lens.fy * l.slope_y);         // [px]
    if constexpr (D::distorts)
        s.centre = Vec2<T>(lens.fx * l.bent.here.at[0], lens.fy * l.bent.here.at[1]);
    s.depth = l.point[2];
    s.covariance = detail::gram(x, y, lens.dilation);
    s.determinant = detail::gram_determinant(x, y, lens.dilation);
    s.precision = detail::precision_factor(x, y, lens.dilation);
    // A bound on the magnitude instead of isfinite, so that NaN fails it too; the reciprocal of a
    // smaller determinant would not be finite.
    const T large = T(Limits<real_t<T>>::largest / 4);
    const T extent = s.covariance.xx + s.covariance.yy + s.determinant;
    const auto shaped = (extent < large) && (s.determinant * large > T(1));
    const auto placed = (s.centre[0] * s.centre[0] + s.centre[1] * s.centre[1]) < large;
    s.drawable = l.in_front && shaped && placed;
    return s;
}

namespace detail {

/// Returns the cotangent of (x/z, y/z) through D at the point, and, within the limits, through the
/// rows of J W: directly and by D'.
template <Scalar T, class D>
RYE_HD Vec2<T> distorted_slope_vjp(const Linearised<T, D>& l, const Projector<T, D>& lens,
                                   const Vec2<T>& g_centre, const Vec3<T>& g_toward_x,
                                   const Vec3<T>& g_toward_y) {
    const Mat3<T>& w = lens.camera_from_world.rotation;
    const Sym2<T>& here = l.bent.here.slope;
    const Sym2<T>& j = l.bent.limited.slope;
    const T px = lens.fx * l.inverse_depth, py = lens.fy * l.inverse_depth;
    const T gx = lens.fx * g_centre[0], gy = lens.fy * g_centre[1];
    Vec3<T> forward, right, down;
    for (int i = 0; i < 3; ++i) {
        forward[i] = w(2, i);
        right[i] = w(0, i) - l.bent.place[0] * w(2, i);
        down[i] = w(1, i) - l.bent.place[1] * w(2, i);
    }
    const T ahead_x = px * dot(forward, g_toward_x), ahead_y = py * dot(forward, g_toward_y);
    const Sym2<T> g_j{px * dot(right, g_toward_x),
                      px * dot(down, g_toward_x) + py * dot(right, g_toward_y),
                      py * dot(down, g_toward_y)};
    const Vec2<T> by_j = lens.distortion.slope_vjp(l.bent.place, g_j);
    return Vec2<T>(
        here.xx * gx + here.xy * gy -
            select(l.free_x, T(j.xx * ahead_x + j.xy * ahead_y - by_j[0]), T(0)),
        here.xy * gx + here.yy * gy -
            select(l.free_y, T(j.xy * ahead_x + j.yy * ahead_y - by_j[1]), T(0)));
}

} // namespace detail

/// Returns the cotangents of mean, rotation and scale. Sigma = M M^T + d I gives g_M = 2 g_Sigma M,
/// in whitened terms L^T (moment) (L M). `alpha` is the cotangent of log(opacity), which depends on
/// the shape only through a MipGaussian's share.
template <Antialias how = Antialias::dilate, Scalar T, Distortion D>
RYE_HD Shape<T> project_vjp(const Shape<T>& g, const Projector<T, D>& lens,
                            const ScreenCotangent<T>& c, [[maybe_unused]] const T& alpha = T(0)) {
    const detail::Linearised<T, D> l(g, lens);
    const Vec3<T> x = detail::scaled_by(l.along_x, g.scale);
    const Vec3<T> y = detail::scaled_by(l.along_y, g.scale);
    const detail::PrecisionFactor<T> f = detail::precision_factor(x, y, lens.dilation);

    const Vec3<T> second = detail::whitened_second_row(l, g.scale, f, lens.dilation);
    Vec3<T> g_x, g_y;                                                     // cotangents of M's rows
    for (int i = 0; i < 3; ++i) {
        const T u = f.k1 * x[i], v = second[i];                           // L M
        const T mu = c.moment.xx * u + c.moment.xy * v;
        const T mv = f.k2 * (c.moment.xy * u + c.moment.yy * v);
        g_x[i] = f.k1 * mu - f.m * mv;
        g_y[i] = mv;
    }
    if constexpr (how == Antialias::mip)
        dilation_share_vjp(x, y, lens.dilation, alpha, g_x, g_y);

    Shape<T> r;
    const Vec3<T> h_x = detail::scaled_by(g_x, g.scale), h_y = detail::scaled_by(g_y, g.scale);
    Mat3<T> g_axes;
    Vec3<T> g_toward_x, g_toward_y;
    for (int i = 0; i < 3; ++i) {
        r.scale[i] = l.along_x[i] * g_x[i] + l.along_y[i] * g_y[i];
        for (int j = 0; j < 3; ++j)
            g_axes(j, i) = l.toward_x[j] * h_x[i] + l.toward_y[j] * h_y[i];
        const Vec3<T> row = l.axes.row(i);
        g_toward_x[i] = dot(row, h_x);
        g_toward_y[i] = dot(row, h_y);
    }
    const Quat<T> unit = quat_normalized(g.rotation);
    r.rotation = quat_normalized_vjp(g.rotation, quat_matrix_vjp(unit, g_axes));

    const Vec3<T> forward = lens.camera_from_world.rotation.row(2);
    const T px = lens.fx * l.inverse_depth, py = lens.fy * l.inverse_depth;
    T g_slope_x, g_slope_y;
    if constexpr (D::distorts) {
        const Vec2<T> bent = detail::distorted_slope_vjp(l, lens, c.centre, g_toward_x, g_toward_y);
        g_slope_x = bent[0];
        g_slope_y = bent[1];
    } else {
        g_slope_x = lens.fx * c.centre[0] -
                    select(l.free_x, T(px * dot(forward, g_toward_x)), T(0));
        g_slope_y = lens.fy * c.centre[1] -
                    select(l.free_y, T(py * dot(forward, g_toward_y)), T(0));
    }
    // d/dz of all that is proportional to 1/z: J W, and both slopes.
    const T g_depth = c.depth - l.inverse_depth * (dot(l.toward_x, g_toward_x) +
                                                   dot(l.toward_y, g_toward_y) +
                                                   l.slope_x * g_slope_x + l.slope_y * g_slope_y);
    r.mean = lens.camera_from_world.turn_back(
        Vec3<T>(l.inverse_depth * g_slope_x, l.inverse_depth * g_slope_y, g_depth));
    return r;
}

} // namespace rye
