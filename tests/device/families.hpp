// SPDX-License-Identifier: Apache-2.0
// families.hpp: every formula that a device needs, by family. A family maps inputs in -1..1 to the
// range of its formulas; evaluate<S>(x, y) runs on host and device, for any scalar S that the
// family supports, and writes every output of the formulas.
//
// To add a family, add a struct here and a line in formulas.cu.
#pragma once

#include <type_traits>

#include <rye/autodiff/widen.hpp>
#include <rye/avatar/eye_kappa.hpp>
#include <rye/gaussian/attributes.hpp>
#include <rye/gaussian/sh_color.hpp>
#include <rye/geometry/sphere_path.hpp>
#include <rye/loss/dssim.hpp>
#include <rye/math/exponential.hpp>
#include <rye/nn/activations.hpp>
#include <rye/nn/encoding.hpp>
#include <rye/rig/cornea.hpp>
#include <rye/rig/eye_dynamics.hpp>
#include <rye/rig/eye_transform.hpp>
#include <rye/rig/gaze_at.hpp>
#include <rye/rig/influence.hpp>
#include <rye/splat/blend.hpp>
#include <rye/splat/footprint.hpp>
#include <rye/splat/ray_peak.hpp>

namespace families {

using namespace rye;

/// Reads a family's inputs and writes its outputs, one after the other.
template <class S>
struct Reader {
    const S* at;

    /// From -1..1 to low..high.
    RYE_HD S number(double low, double high) {
        return constant<S>(0.5 * (low + high)) + constant<S>(0.5 * (high - low)) * *at++;
    }
    template <int N>
    RYE_HD Vec<S, N> vector(double low = -1, double high = 1) {
        Vec<S, N> v;
        for (int i = 0; i < N; ++i) v[i] = number(low, high);
        return v;
    }
    RYE_HD Mat3<S> matrix() {
        Mat3<S> m;
        for (int i = 0; i < 9; ++i) m.data()[i] = number(-1, 1);
        return m;
    }
};
template <class S>
struct Writer {
    S* at;

    template <class... X>
    RYE_HD void operator()(const X&... x) {
        (put(x), ...);
    }

  private:
    RYE_HD void put(const S& x) { *at++ = x; }
    RYE_HD void put(bool x) { *at++ = S(x ? 1 : 0); }
    RYE_HD void put(int x) { *at++ = S(real_t<S>(x)); }
    template <int R, int C>
    RYE_HD void put(const Eigen::Matrix<S, R, C>& m) {
        for (int i = 0; i < R * C; ++i) *at++ = m.data()[i];
    }
    template <std::size_t N>
    RYE_HD void put(const Array<S, N>& a) {
        for (const S& x : a) *at++ = x;
    }
    RYE_HD void put(const Sym2<S>& m) { (*this)(m.xx, m.xy, m.yy); }
    RYE_HD void put(const Span& s) { (*this)(s.begin, s.end); }
};

/// Ends of a family's reads and writes, to check its counts.
template <class S>
struct Ends {
    const S* in;
    const S* out;
};

/// Tolerance of a family: of each output, the difference over the greater of the number itself and
/// the output's root mean square over all inputs, in units of the scalar's epsilon. `ulps` is about
/// four times the effect of fused products, and more than a few where an input makes numbers nearly
/// equal. `apart`, where present, is the fraction of inputs for which rounding may change a
/// decision, where nothing is compared.
struct Scalars {
    static constexpr const char* name = "scalars";
    static constexpr int inputs = 6, outputs = 10;
    static constexpr double ulps = 128;

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        Writer<S> out{y};
        const S a = in.number(-20, 20), b = in.number(-3, 3), p = in.number(0.01, 0.99);
        out(sigmoid(a), softplus(a), logit(p), clamp_value(b, S(-1), S(1)), detail::sign_of(b),
            square(a));
        out(min(a, b), max(a, b), select(a < b, a, b), value_of(a) < value_of(b));
        return {in.at, out.at};
    }
};

/// Functions that formulas call by `using std::f`.
struct Functions {
    static constexpr const char* name = "functions";
    static constexpr int inputs = 3, outputs = 24;
    static constexpr double ulps = 64;

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        using std::abs, std::acos, std::asin, std::atan, std::atan2, std::cos, std::exp, std::exp2,
            std::expm1, std::floor, std::hypot, std::isfinite, std::isnan, std::log, std::log1p,
            std::log2, std::pow, std::sin, std::sqrt, std::tan, std::tanh;
        Reader<S> in{x};
        Writer<S> out{y};
        const S a = in.number(-1.2, 1.2), b = in.number(0.5, 3), c = in.number(-0.9, 0.9);
        out(abs(a), acos(c), asin(c), atan(a), atan2(a, b), cos(a), exp(a), exp2(a), expm1(a));
        out(floor(a), hypot(a, b), isfinite(a), isnan(a), log(b), log1p(b), log2(b), pow(b, a));
        out(pow(b, S(1.5)), sin(a), sqrt(b), tan(a), tanh(a), a / b);
        out(S(value_of(detail::scalar_cast<S>(a))));
        return {in.at, out.at};
    }
};

struct Vectors {
    static constexpr const char* name = "vectors";
    static constexpr int inputs = 10, outputs = 30;
    static constexpr double ulps = 64;

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        Writer<S> out{y};
        const Vec3<S> a = in.template vector<3>(), b = in.template vector<3>();
        const Vec3<S> g = in.template vector<3>();
        const S d = in.number(0.1, 0.5);
        out(dot(a, b), cross(a, b), normalized(a), norm(a), normalized_vjp(a, g));
        const Sym2<S> m = detail::gram(a, b, d);
        Mat3<S> rows;
        for (int i = 0; i < 3; ++i) rows(0, i) = a[i], rows(1, i) = b[i], rows(2, i) = g[i];
        const Sym3<S> s = detail::gram(rows);
        const detail::PrecisionFactor<S> f = detail::precision_factor(a, b, d);
        out(m, m.determinant(), m.quadratic(Vec2<S>(a[0], b[0])), pairing(m, m));
        out(s.xx, s.xy, s.xz, s.yy, s.yz, s.zz);
        out(detail::gram_determinant(a, b, d), f.k1, f.k2, f.m, f.quadratic(a[0], a[1]));
        out(dilation_share(a, b, d), select_all(a[0] < b[0], a, b)[0]);
        return {in.at, out.at};
    }
};

struct Rotations {
    static constexpr const char* name = "rotations";
    static constexpr int inputs = 24, outputs = 88;
    static constexpr double ulps = 64;

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        Writer<S> out{y};
        const Quat<S> p = in.template vector<4>(0.1, 1), q = in.template vector<4>();
        const Vec3<S> w = in.template vector<3>(-1.5, 1.5), v = in.template vector<3>();
        const Mat3<S> g = in.matrix();
        const S t = in.number(0, 1);
        const Quat<S> a = quat_normalized(p), b = quat_normalized(so3_exp_quat(w));
        const Mat3<S> r = so3_exp(w);
        out(quat_identity<S>(), a, b, quat_normalized_vjp(p, q), quat_product(a, b));
        out(quat_product_vjp_left(b, q), quat_product_vjp_right(a, q), quat_matrix(a));
        out(quat_matrix_vjp(a, g), quat_rotate(a, v), matrix_quat(r), r, so3_exp_vjp(w, g));
        out(shortest_arc(Vec3<S>(S(0), S(0), S(1)), normalized(Vec3<S>(v[0], v[1], S(1)))));
        out(quat_slerp(a, b, t), quat_log(b), so3_log(r), detail::sinc_of_square(S(t + t)));
        out(detail::sinc_of_square_slope(S(t + t)));
        const Rigid<S> one{r, v}, other{quat_matrix(a), w}, both = compose(one, other);
        out(both.apply(v), both.turn_back(w), one.inverse().translation, both.turn(v));
        return {in.at, out.at};
    }
};

struct Exponentials {
    static constexpr const char* name = "exponentials";
    static constexpr int inputs = 1, outputs = 5;
    static constexpr double ulps = 16;

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        Writer<S> out{y};
        const S a = in.number(-24, 4);
        out(Exp2Poly<3>()(a), Exp2Poly<4>()(a), Exp2Poly<5>()(a), Exp2Poly<6>()(a));
        out(Exp2Library()(a));
        return {in.at, out.at};
    }
};

struct Harmonics {
    static constexpr const char* name = "harmonics";
    static constexpr int inputs = 3 + 25, outputs = 1 + 4 + 9 + 16 + 25 + 3 * 5;
    static constexpr double ulps = 64;

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        Writer<S> out{y};
        const Vec3<S> d = normalized(Vec3<S>(in.template vector<3>()));
        degree<0>(d, in.at, out);
        degree<1>(d, in.at, out);
        degree<2>(d, in.at, out);
        degree<3>(d, in.at, out);
        degree<4>(d, in.at, out);
        return {in.at + 25, out.at};
    }

  private:
    template <int Degree, class S>
    RYE_HD static void degree(const Vec3<S>& d, const S* given, Writer<S>& out) {
        ShArray<S, Degree> g;
        for (std::size_t k = 0; k < g.size(); ++k) g[k] = given[k];
        out(sh_basis<S, Degree>(d), sh_basis_vjp<S, Degree>(d, g));
    }
};

struct Colours {
    static constexpr const char* name = "colours";
    static constexpr int inputs = 3 + 3 + 3 + 3 + 45, outputs = 3 + 3 + 3 + 45;
    static constexpr double ulps = 64;
    static constexpr double apart = 0.001;   // at a colour of 0

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        Writer<S> out{y};
        const Vec3<S> mean = in.template vector<3>(), eye = in.template vector<3>(2, 4);
        const Vec3<S> band = in.template vector<3>(), g = in.template vector<3>();
        const ShColor<S, 3> colour(mean, eye, band.data(), in.at);
        S* const g_band = y + 6;
        out(colour.rgb(), colour.vjp(g, in.at, g_band, g_band + 3));
        return {in.at + 45, out.at + 48};
    }
};

/// A camera and a Gaussian before it.
template <class S, class D>
struct Scene {
    Pinhole<S, D> camera;
    Shape<S> shape;
    S opacity;

    RYE_HD Scene(Reader<S>& in, const D& distortion) {
        camera.fx = in.number(500, 600), camera.fy = in.number(500, 600);
        camera.cx = in.number(200, 300), camera.cy = in.number(200, 300);
        camera.width = camera.height = 512;
        camera.distortion = distortion;
        camera.camera_from_world.rotation = so3_exp(Vec3<S>(in.template vector<3>(-0.2, 0.2)));
        camera.camera_from_world.translation =
            Vec3<S>(in.number(-0.2, 0.2), in.number(-0.2, 0.2), in.number(3, 4));
        shape.mean = in.template vector<3>();
        shape.rotation = in.template vector<4>(0.2, 1);
        shape.scale = in.template vector<3>(0.002, 0.1);
        opacity = in.number(0.1, 0.9);
    }
};

template <Antialias how, bool bends>
struct Projection {
    static constexpr const char* name = bends ? "projection, bent"
                                        : how == Antialias::mip ? "projection, mip" : "projection";
    static constexpr int inputs = 21 + 6 + 4, outputs = 15 + 10;
    static constexpr double ulps = 1024;

    template <class S>
    RYE_HD static auto lens_of(Reader<S>& in) {
        if constexpr (bends)
            return BrownConrady<S>{in.number(-0.2, 0.1), in.number(-0.05, 0.05), S(0),
                                   in.number(-0.01, 0.01), in.number(-0.01, 0.01)};
        else
            return NoDistortion();
    }

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        Writer<S> out{y};
        using D = decltype(lens_of(in));
        const Scene<S, D> scene(in, lens_of(in));
        const Projector<S, D> lens(scene.camera, 0.3, 0.3);
        const ScreenCotangent<S> g{in.template vector<2>(),
                                   {in.number(-1, 1), in.number(-1, 1), in.number(-1, 1)},
                                   in.number(-1, 1)};
        const Projected<S, how> s = project<how>(scene.shape, lens);
        out(s.centre, s.depth, s.covariance, s.determinant, bool(s.drawable));
        out(s.precision.k1, s.precision.k2, s.precision.m, detail::kept_opacity(s, scene.opacity));
        out(scene.camera.project_point(scene.shape.mean));
        const Shape<S> v = project_vjp<how>(scene.shape, lens, g, S(0.5));
        out(v.mean, v.rotation, v.scale);
        return {in.at, out.at};
    }
};

/// From a pixel back to the world.
template <bool bends>
struct Rays {
    static constexpr const char* name = bends ? "rays, bent" : "rays";
    static constexpr int inputs = 21 + 4 + 2, outputs = 6;
    static constexpr double ulps = 32;

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        Writer<S> out{y};
        using P = Projection<Antialias::none, bends>;
        using D = decltype(P::lens_of(in));
        const Scene<S, D> scene(in, P::lens_of(in));
        out(scene.camera.centre(), scene.camera.ray(in.template vector<2>(0, 512)));
        return {in.at, out.at};
    }
};

/// The numbers of the accuracy policies.
struct Policies {
    static constexpr const char* name = "policies";
    static constexpr int inputs = 1, outputs = 8;
    static constexpr double ulps = 4;

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        Writer<S> out{y};
        const S a = in.number(1, 2);
        const auto times = [&](double number) { return a * constant<S>(number); };
        out(times(Exact64().stop), times(Exact32().stop), times(Tight().stop), times(Fast().stop));
        out(times(Balanced().stop), times(Compatible3dgs().alpha_max));
        out(times(FeaturesOnly<Tight>().alpha_min), times(screen_dilation(Compatible3dgsFloor())));
        return {in.at, out.at};
    }
};

template <class A>
struct Splats {
    static constexpr const char* name =
        A::support == Support::square ? "splats, square" : "splats";
    static constexpr int inputs = 21 + 9, outputs = 9 + 6 + 3 + 3 + 2 + 2 + 2 + 1 + 4;
    static constexpr double ulps = 512;
    static constexpr double apart = 0.01;    // whole pixels and tiles

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        Writer<S> out{y};
        const Scene<S, NoDistortion> scene(in, {});
        const Pinhole<S>& camera = scene.camera;
        const A accuracy;
        const Projector<S> lens(camera, accuracy.frustum_margin, screen_dilation(accuracy));
        const ScreenGaussian<S> s = project(scene.shape, lens);
        const Splat<S> splat = make_splat(s, scene.opacity, accuracy);
        const SplatCotangent<S> g{in.number(-1, 1), in.number(-1, 1), in.number(-1, 1),
                                  in.number(-1, 1), in.number(-1, 1), in.number(-1, 1),
                                  in.number(-1, 1)};
        const ScreenCotangent<S> c = detail::screen_cotangent(splat, g);
        const S dx = in.number(-3, 3), dy = in.number(-3, 3);
        const Response<S> r = respond(splat, dx, dy);
        out(splat.x, splat.y, splat.ux, splat.vx, splat.vy, splat.log2_opacity, splat.cut);
        out(splat.floor, splat.depth, c.centre, c.moment, c.depth, r.u, r.v, r.exponent);
        const detail::RayPeak<S> peak =
            detail::ray_peak(scene.shape, camera.camera_from_world, camera.fx, camera.fy);
        out(peak.at(dx, dy), peak.along[0], peak.depth);
        const Footprint<S> f = detail::footprint_of<A>(s, splat, camera.cx, camera.cy);
        const Cover<A::support, S> cover{f, camera.width, camera.height};
        const Span rows = cover.rows(),
                   columns = cover.columns(rows.begin / detail::tile_edge, rows);
        out(rows, columns, tiles_of(rows), detail::depth_key(s.depth) > detail::depth_key(S(3)));
        detail::TileRows known{rows, {}};
        known.columns[0][1] = static_cast<std::uint16_t>(columns.end);
        out(known.first_row(), known.last_row() * int(known.known(camera.width)));
        out(int(known.columns[0][1]), tiles_across(rows.end));
        return {in.at, out.at};
    }
};

/// A Gaussian at a pixel: value, jvp and vjp.
template <class A>
struct Blending {
    static constexpr const char* name =
        A::stop_rule == Stop::inclusive ? "blending, inclusive" : "blending, exclusive";
    static constexpr int inputs = 14, outputs = 15;
    static constexpr double ulps = 512;
    static constexpr double apart = 0.01;    // within the footprint or not, saturated or not

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        Writer<S> out{y};
        const Blend<A, S, detail::PixelGroup, Exp2Library> blend{A()};
        const S u = in.number(-1, 1), v = in.number(-1, 1);
        Splat<S> s;
        s.log2_opacity = in.number(-4, 0);
        s.cut = in.number(-8, -3);
        s.floor = in.number(0, 0.01);
        s.depth = in.number(1, 3);
        const S exponent = detail::less_square(detail::less_square(s.log2_opacity, u), v);
        S transmittance = in.number(0.01, 1), moved = in.number(-1, 1), behind = in.number(-1, 1);
        const auto c = blend.take(blend.coverage(exponent, s.cut, s.floor), transmittance);
        const S weight = blend.take_jvp(c, in.number(-1, 1), in.number(-0.01, 0.01), moved);
        detail::PixelCotangent<S> g;
        g.colour = in.number(-1, 1);
        g.alpha = in.number(-1, 1);
        g.depth = in.number(-1, 1);
        Array<S, 7> sum;
        for (S& one : sum) one = S(0);
        blend.take_vjp(c, u, v, s, g, behind, sum);
        out(c.alpha, c.weight, transmittance, weight, moved, behind, sum);
        out(bool(blend.open(transmittance)), s.cut);
        return {in.at, out.at};
    }
};

template <class Metric>
struct Influences {
    static constexpr const char* name = std::is_same_v<Metric, SquaredDistance>
                                            ? "influence, squared" : "influence, euclidean";
    static constexpr int inputs = 6, outputs = 2;
    static constexpr double ulps = 128;
    static constexpr double apart = 0.001;   // at the ramp's ends

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        Writer<S> out{y};
        const Vec3<S> d = in.template vector<3>(0, 0.3) - in.template vector<3>(0, 0.3);
        const Ramp<S> ramp{constant<S>(0.02), constant<S>(0.15)};
        out(influence(Metric(), ramp, dot(d, d)),
            detail::influence_slope(Metric(), ramp, dot(d, d)));
        return {in.at, out.at};
    }
};

struct Eyes {
    static constexpr const char* name = "eyes";
    static constexpr int inputs = 3 + 3 + 3 + 3 + 3 + 2 + 4, outputs = 52;
    static constexpr double ulps = 512;

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        Writer<S> out{y};
        const Vec3<S> centre = in.template vector<3>(), point = in.template vector<3>(-0.1, 0.1);
        const Vec3<S> g = in.template vector<3>(), turn = in.template vector<3>();
        const HeadPlacement<S> head{{so3_exp(turn), in.template vector<3>()}, constant<S>(1.1)};
        const S pitch = in.number(-0.8, 0.8), yaw = in.number(-0.8, 0.8);
        const Quat<S> q = quat_normalized(Quat<S>(in.template vector<4>(0.1, 1)));
        const KappaAngles<S> kappa{constant<S>(0.03), constant<S>(0.09)};
        const Vec3<S> gaze = gaze_vector(pitch, yaw), optical = apply_kappa(gaze, kappa);
        EyeTransform<S> e = detail::eye_at(centre);
        turn_eye_to(e, normalized(optical));
        detail::carry_eye(e, head);
        out(gaze, optical, gaze_from_kappa(optical, kappa), pitch_yaw(optical));
        out(angular_error(gaze, optical), chord_error(gaze, optical));
        out(e.rotation, e.quaternion, e.translation, e.scale, e.beyond_range);
        out(e.apply(point), into_eye(e, e.apply(point)), detail::eye_offset_cotangent(e, g));
        out(quat_product(e.quaternion, q), quat_product_vjp_right(e.quaternion, q));
        out(gaze_in_head(e.rotation, gaze), gaze_in_world(e.rotation, gaze)[0]);
        return {in.at, out.at};
    }
};

/// Eyes that look at a point, and how fast eyes and lids move.
struct LivingEyes {
    static constexpr const char* name = "living eyes";
    static constexpr int inputs = 3 + 3 + 2 + 3 + 3 + 3 + 2, outputs = 7 + 4 + 3 + 3 + 4;
    static constexpr double ulps = 512;

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        Writer<S> out{y};
        const Vec3<S> centre = in.template vector<3>(-0.4, 0.4), aside = in.template vector<3>();
        const GazeTarget<S> target{Vec3<S>(S(2) * aside[0], aside[1], S(4) + aside[2])};
        const KappaAngles<S> kappa{in.number(-0.1, 0.1), in.number(-0.1, 0.1)};
        const Vec3<S> before = in.template vector<3>(-0.6, 0.6),
                      now = in.template vector<3>(-0.6, 0.6);
        const HeadPlacement<S> head{{so3_exp(before), in.template vector<3>()}, constant<S>(1.1)};
        const S amplitude = in.number(0.01, 0.5), t = in.number(-0.1, 0.3);
        const AimedEye<S> eye = aim_eye(centre, target, kappa, constant<S>(0.5));
        out(eye.visual, eye.optical, eye.missed);
        const GazeTarget<S> there = target_in_head(head, target);
        out(there.point, there.weight,
            detail::target_in_range(centre, target, constant<S>(0.3)).point);
        out(steadied_gaze(so3_exp(before), so3_exp(now), eye.visual));
        out(saccade_peak_speed(amplitude), saccade_duration(amplitude));
        out(detail::saccade_travel(amplitude, t), detail::blink_closure(t));
        return {in.at, out.at};
    }
};

/// The head's motion, and kappa, of points, and back.
struct Motions {
    static constexpr const char* name = "motions of head and eyes";
    static constexpr int inputs = 6 + 3 + 4 + 3 + 4 + 2, outputs = 16 + 3 + 7 + 16 + 6 + 4 + 2;
    static constexpr double ulps = 512;

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        Writer<S> out{y};
        const Vec<S, 6> pose = in.template vector<6>();
        const HeadTransform<S> head = head_transform<S>(pose, constant<S>(1.1));
        const Mat3<S> scaled = head.scale * head.rotation;
        detail::MovedPoint<S> world{in.template vector<3>(), in.template vector<4>(0.1, 1)};
        detail::MovedPoint<S> g{in.template vector<3>(), in.template vector<4>()};
        const Vec3<S> at_rest = world.mean;
        world.mean = mean_to_world<S>(head, scaled, at_rest);
        out(head.rotation, head.quaternion, head.translation, world.mean);
        HeadTransformGradient<S> sum;
        sum.add(head, world, g);
        out(g.mean, g.rotation, sum.rotation, sum.quaternion, sum.translation);
        out(head_pose_vjp<S>(pose, sum));
        detail::NearestSoFar<S> nearest;
        nearest.offer(at_rest[0], at_rest[1], at_rest[2], 0);
        nearest.offer(world.mean[0], world.mean[1], world.mean[2], 1);
        out(nearest.squared, detail::influence_pull<S>(nearest.squared, at_rest));
        detail::TurnCotangent<S> turn;
        turn.add({at_rest, world.rotation}, g);
        const S pitch = in.number(-0.8, 0.8), yaw = in.number(-0.8, 0.8);
        const KappaTangent<S> tangent(gaze_vector(pitch, yaw),
                                      KappaAngles<S>{constant<S>(0.03), constant<S>(0.09)});
        out(tangent.of_turn(turn, 0), tangent.of_turn(turn, 1));
        return {in.at, out.at};
    }
};

struct Encodings {
    static constexpr const char* name = "encoding";
    static constexpr int inputs = 1 + 9, outputs = 9 + 1;
    static constexpr double ulps = 16;

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        detail::encode_number(in.number(-3, 3), detail::default_frequencies, 1, y);
        y[9] = detail::encode_number_vjp(y, in.at, detail::default_frequencies, 1);
        return {in.at + 9, y + outputs};
    }
};

struct Activations {
    static constexpr const char* name = "activations";
    static constexpr int inputs = 4, outputs = 16;
    static constexpr double ulps = 2048;
    static constexpr double apart = 0.001;   // at the ends of a clamp

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        Writer<S> out{y};
        const S v = in.number(-4, 4), g = in.number(-1, 1), b = in.number(-0.1, 1.1);
        out(leaky_relu(v), leaky_relu_vjp(v, g), relu(v), relu_vjp(v, g));
        const S t = detail::squash_value(Squash::tanh, v),
                s = detail::squash_value(Squash::sigmoid, v);
        out(t, s, detail::squash_value(Squash::none, v), detail::squash_slope(Squash::tanh, t));
        out(detail::squash_slope(Squash::sigmoid, s), detail::squash_slope(Squash::none, v));
        const S scale = drawn_scale(v), opacity = drawn_opacity(v);
        out(scale, detail::drawn_scale_vjp(scale, g), opacity,
            detail::drawn_opacity_vjp(opacity, S(S(1) - s), g));
        out(detail::odds_sigmoid(detail::clamped_base(b), v), detail::clamped_base_vjp(b, g));
        return {in.at, out.at};
    }
};

struct SsimWindow {
    static constexpr const char* name = "SSIM's window";
    static constexpr int inputs = 2 * detail::ssim_window, outputs = 1 + 4;
    static constexpr double ulps = 2048;

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        Writer<S> out{y};
        const Array<double, detail::ssim_window> weight = detail::ssim_weights();
        S u(0), v(0), squares(0), xy(0);
        for (std::size_t k = 0; k < weight.size(); ++k) {
            const S w = constant<S>(weight[k]), p = in.number(0, 1), q = in.number(0, 1);
            u += w * p, v += w * q, squares += w * (p * p + q * q), xy += w * (p * q);
        }
        const detail::SsimSlopes<S> s = detail::ssim_slopes(
            u, v, S(xy - u * v), S(squares - (u * u + v * v)), constant<S>(0.01));
        out(constant<S>(weight[0]), s.value, s.by_x, s.by_xx, s.by_xy);
        return {in.at, out.at};
    }
};

struct Corneas {
    static constexpr const char* name = "cornea";
    static constexpr int inputs = 3 * 4 + 1, outputs = 3 + 7 + 4 + 6 + 1;
    static constexpr double ulps = 1024;
    static constexpr double apart = 0.01;    // at the cornea's rim, and where Newton's method stops

    template <class S>
    RYE_HD static Ends<S> evaluate(const S* x, S* y) {
        Reader<S> in{x};
        Writer<S> out{y};
        const Vec3<S> ahead(S(0), S(0), S(1)), zero(S(0), S(0), S(0));
        const Cornea<S> cornea{constant<S>(0.056) * ahead, constant<S>(0.078), ahead,
                               constant<S>(0.1)};
        const Vec3<S> camera(in.number(-2, 2), in.number(-2, 2), in.number(5, 8));
        const Vec3<S> light(in.number(-4, 4), in.number(-4, 4), in.number(4, 9));
        const Vec3<S> point(in.number(-0.04, 0.04), in.number(-0.04, 0.04), in.number(0.09, 0.1));
        const Vec3<S> g = in.template vector<3>();
        const S index = in.number(1.2, 1.4), width = constant<S>(0.3);
        Vec3<S> g_camera = zero;
        const RefractingCornea<S> refracting{cornea, index};
        out(seen_through(refracting, camera, point));
        SeenThroughGradient<S> sum{zero, S(0)};
        out(seen_through_vjp(refracting, camera, point, g, sum), sum.camera, sum.index);
        const Mirrored<S> m = mirrored(cornea, camera, point);
        out(m.to, m.strength);
        out(mirrored_vjp(cornea, camera, point, Mirrored<S>{g, S(1)}, g_camera), g_camera);
        out(light_lobe(m.to, normalized(light), width));
        return {in.at, out.at};
    }
};

} // namespace families
