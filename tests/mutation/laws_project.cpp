// SPDX-License-Identifier: Apache-2.0
// gaussian/project.hpp and splat/falloff.hpp: from a Gaussian to the exponent at a pixel.
#include <rye/gaussian/project.hpp>
#include <rye/gaussian/sh_color.hpp>

#include "../support/operator_laws.hpp"

using namespace rye;
using namespace rye::laws;

namespace {

template <class S>
Shape<S> shape_of(const Columns<S>& x) {
    using std::exp, std::sin;
    Shape<S> s;
    s.mean = Vec3<S>(S(0.5F) * x(0, 0), S(0.5F) * x(1, 0), S(3) + S(0.5F) * sin(x(2, 0)));
    s.rotation = Quat<S>(S(2) + x(3, 0), x(4, 0), x(5, 0), x(6, 0));
    for (int i = 0; i < 3; ++i) s.scale[i] = S(0.3F) * exp(S(0.5F) * sin(x(7 + i, 0)));
    return s;
}
template <class S>
Projector<S> lens_of(bool clamped) {
    using R = real_t<S>;
    Pinhole<R> c;
    c.fx = R(100), c.fy = R(110), c.cx = R(40), c.cy = R(20), c.width = 64, c.height = 48;
    const Quat<double> q = quat_normalized(Quat<double>(1, 0.1, -0.2, 0.05));
    c.camera_from_world = {Mat3<R>(quat_matrix(q).cast<R>()), Vec3<R>(R(0.1), R(-0.05), R(0.2))};
    const Projector<R> plain(c, clamped ? -0.95 : 10.0, 0.3);
    return Projector<S>(plain);
}

/// centre, depth, and the two whitened offsets' exponent of a point near it.
template <bool clamped>
void projection(const char* name) {
    const auto op = [](const auto& x) {
        using S = typename std::decay_t<decltype(x)>::Scalar;
        const auto s = project(shape_of(x), lens_of<S>(clamped));
        // The exponent at fixed pixels, a standard deviation off at the origin of x.
        Columns<S> y(4, 1);
        y(0, 0) = S(0.01F) * s.centre[0], y(1, 0) = S(0.01F) * s.centre[1], y(2, 0) = s.depth;
        const S dx = S(12) - s.centre[0], dy = S(-7) - s.centre[1];
        y(3, 0) = S(-0.5F) * s.precision.quadratic(dx, dy);
        return y;
    };
    const auto vjp = [](const auto& x, const auto& g) {
        using S = typename std::decay_t<decltype(x)>::Scalar;
        using std::cos, std::exp, std::sin;
        const Shape<S> shape = shape_of(x);
        const auto lens = lens_of<S>(clamped);
        const auto s = project(shape, lens);
        const auto& p = s.precision;
        const S dx = S(12) - s.centre[0], dy = S(-7) - s.centre[1];
        const S u = p.k1 * dx, v = p.k2 * (dy - p.m * dx), ge = g(3, 0);
        ScreenCotangent<S> c;
        c.centre = Vec2<S>(S(0.01F) * g(0, 0) + ge * (p.k1 * u - p.k2 * p.m * v),
                           S(0.01F) * g(1, 0) + ge * p.k2 * v);
        c.moment = {ge * u * u, ge * u * v, ge * v * v};
        c.depth = g(2, 0);
        const Shape<S> r = project_vjp(shape, lens, c);
        auto out = x;
        out(0, 0) = S(0.5F) * r.mean[0], out(1, 0) = S(0.5F) * r.mean[1];
        out(2, 0) = S(0.5F) * cos(x(2, 0)) * r.mean[2];
        for (int i = 0; i < 4; ++i) out(3 + i, 0) = r.rotation[i];
        for (int i = 0; i < 3; ++i)
            out(7 + i, 0) = S(0.5F) * cos(x(7 + i, 0)) * shape.scale[i] * r.scale[i];
        return out;
    };
    every_law(name, 10, 4, op, vjp, 0.5);
}

void colour() {
    // Mean, 3 constant bands, 24 coefficients of degree 2; raw kept away from the gate.
    const auto op = [](const auto& x) {
        using S = typename std::decay_t<decltype(x)>::Scalar;
        S band[3] = {S(9) + x(3, 0), S(9) + x(4, 0), S(9) + x(5, 0)}, rest[24];
        for (int i = 0; i < 24; ++i) rest[i] = S(0.2F) * x(6 + i, 0);
        const ShColor<S, 2> c(part<3>(x), Vec3<S>(S(0.1F), S(0.2F), S(-4)), band, rest);
        return column(c.rgb());
    };
    const auto vjp = [](const auto& x, const auto& g) {
        using S = typename std::decay_t<decltype(x)>::Scalar;
        S band[3] = {S(9) + x(3, 0), S(9) + x(4, 0), S(9) + x(5, 0)}, rest[24], gb[3], gr[24];
        for (int i = 0; i < 24; ++i) rest[i] = S(0.2F) * x(6 + i, 0);
        const ShColor<S, 2> c(part<3>(x), Vec3<S>(S(0.1F), S(0.2F), S(-4)), band, rest);
        const Vec3<S> mean = c.vjp(part<3>(g), rest, gb, gr);
        auto out = x;
        for (int i = 0; i < 3; ++i) out(i, 0) = mean[i], out(3 + i, 0) = gb[i];
        for (int i = 0; i < 24; ++i) out(6 + i, 0) = S(0.2F) * gr[i];
        return out;
    };
    every_law("sh_color, degree 2", 30, 3, op, vjp);
}

void all() {
    projection<false>("project");
    projection<true>("project, limits acting");
    colour();
}

} // namespace

int main(int argc, char** argv) { return run(argc, argv, all); }
