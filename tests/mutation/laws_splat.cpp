// SPDX-License-Identifier: Apache-2.0
// splat/blend.hpp, plain/vjp.hpp, falloff.hpp and stage.hpp: four Gaussians in 8 x 8 pixels, by plain
// loops and, since the two kinds of pixels round some products differently, in lanes.
#include <rye/splat/lanes.hpp>

#include "../support/operator_laws.hpp"

using namespace rye;
using namespace rye::laws;

namespace {

constexpr Index count = 4, per = 13, pixels = 64;

Compatible3dgsFloor floored() {
    Compatible3dgsFloor a;
    a.alpha_min = 1e-9, a.alpha_max = 1, a.stop = 0, a.alpha_floor = 1e-3;
    return a;
}
Balanced open() {
    Balanced a;
    a.alpha_min = 1e-13, a.alpha_max = 1, a.stop = 0;
    return a;
}

template <class S>
Gaussians<S> gaussians_of(const Columns<S>& x) {
    using std::exp, std::sin;
    Gaussians<S> g(count, 2);
    for (Index i = 0; i < count; ++i) {
        const Index o = i * per;
        for (Index k = 0; k < 2; ++k) g.mean(k, i) = S(0.4F) * sin(x(o + k, 0));
        g.mean(2, i) = S(static_cast<float>(i)) + S(0.3F) * sin(x(o + 2, 0));
        for (Index k = 0; k < 4; ++k) g.rotation(k, i) = x(o + 3 + k, 0) + S(k == 0 ? 2 : 0);
        for (Index k = 0; k < 3; ++k) g.scale(k, i) = S(0.4F) * exp(S(0.3F) * sin(x(o + 7 + k, 0)));
        g.opacity(0, i) = S(0.5F) + S(0.4F) * sin(x(o + 10, 0));
        for (Index k = 0; k < 2; ++k) g.feature(k, i) = x(o + 11 + k, 0);
    }
    return g;
}
template <class S>
Pinhole<S> camera() {
    Pinhole<S> c;
    c.fx = c.fy = S(16), c.cx = S(3.5F), c.cy = S(4.5F), c.width = c.height = 8;
    c.camera_from_world.translation = Vec3<S>(S(0), S(0), S(3));
    return c;
}

template <class B, class A>
void splatting(const char* name, const A& accuracy) {
    const Rasterizer<A> rasterizer{accuracy};
    const auto op = [&](const auto& x) {
        using S = typename std::decay_t<decltype(x)>::Scalar;
        const VecX<S> background = VecX<S>::Constant(2, S(0.3F));
        const auto r =
            rasterizer.forward(B{}, gaussians_of(x), camera<S>(), background);
        Columns<S> y(4 * pixels, 1);
        for (Index p = 0; p < 2 * pixels; ++p) y(p, 0) = r.feature.pixels.data()[p];
        for (Index p = 0; p < pixels; ++p) {
            y(2 * pixels + p, 0) = r.alpha.pixels(0, p);
            y(3 * pixels + p, 0) = r.depth.pixels(0, p);
        }
        return y;
    };
    const auto vjp = [&](const auto& x, const auto& w) {
        using S = typename std::decay_t<decltype(x)>::Scalar;
        using std::cos, std::exp, std::sin;
        const Gaussians<S> g = gaussians_of(x);
        const VecX<S> background = VecX<S>::Constant(2, S(0.3F));
        const auto r = rasterizer.forward(B{}, g, camera<S>(), background);
        const Columns<S> wf = w.topRows(2 * pixels).reshaped(2, pixels);
        const Columns<S> wa = w.middleRows(2 * pixels, pixels).transpose();
        const Columns<S> wd = w.bottomRows(pixels).transpose();
        const auto d =
            rasterizer.vjp(B{}, g, camera<S>(), background, r, wf, &wa, &wd);
        auto out = x;
        for (Index i = 0; i < count; ++i) {
            const Index o = i * per;
            for (Index k = 0; k < 2; ++k) out(o + k, 0) = S(0.4F) * cos(x(o + k, 0)) * d.mean(k, i);
            out(o + 2, 0) = S(0.3F) * cos(x(o + 2, 0)) * d.mean(2, i);
            for (Index k = 0; k < 4; ++k) out(o + 3 + k, 0) = d.rotation(k, i);
            for (Index k = 0; k < 3; ++k)
                out(o + 7 + k, 0) = S(0.3F) * cos(x(o + 7 + k, 0)) * g.scale(k, i) * d.scale(k, i);
            out(o + 10, 0) = S(0.4F) * cos(x(o + 10, 0)) * d.opacity(0, i);
            for (Index k = 0; k < 2; ++k) out(o + 11 + k, 0) = d.feature(k, i);
        }
        return out;
    };
    first_order<double>(name, count * per, 4 * pixels, op, vjp);
    if constexpr (!quick) first_order<float>(name, count * per, 4 * pixels, op, vjp);
}

void all() {
    draws = std::max(1, draws / 50); // of 16 pictures each
    using Plain = ScalarBackend<Serial>;
    using Lanes = XsimdBackend<DefaultArch, Serial>;
    splatting<Plain>("rasterizer", open());
    splatting<Plain>("rasterizer, floor", floored());
    splatting<Lanes>("rasterizer in lanes", open());
    splatting<Lanes>("rasterizer in lanes, floor", floored());
}

} // namespace

int main(int argc, char** argv) { return run(argc, argv, all); }
