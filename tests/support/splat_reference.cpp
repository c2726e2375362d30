// SPDX-License-Identifier: Apache-2.0
#include "splat_reference.hpp"

#include <rye/autodiff/dual.hpp>
#include <rye/splat/rasterizer.hpp>

namespace rye::test {

namespace {

using Plain = ScalarBackend<Serial>;

Scenery<double> in_double(const Scenery<float>& s) {
    Scenery<double> d{s.name, {}, s.camera.cast<double>(), s.background.cast<double>()};
    convert_fields(d.gaussians, s.gaussians, [](float x) { return static_cast<double>(x); });
    return d;
}

template <class T>
OracleImages true_images(const Scenery<T>& s) {
    Gaussians<double> g;
    convert_fields(g, s.gaussians, [](T x) { return static_cast<double>(x); });
    return oracle(g, s.camera.template cast<double>(), s.background.template cast<double>(),
                  depth_order(s.gaussians, s.camera));
}

template <class A, class T>
PlainImages<T> plain_images(const Scenery<T>& s, const A& accuracy) {
    using Both = Drawing<A, Outputs{.depth = true, .contributor = true}>;
    const auto r = Rasterizer<Both>{accuracy}.forward(Plain{}, s.gaussians, s.camera, s.background);
    return {r.feature.pixels, r.alpha.pixels, r.depth.pixels, r.contributor.pixels};
}

template <class A>
double slope_by_duals(const Scenery<double>& s, const A& accuracy, const Gaussians<double>& v,
                      const Weights<double>& w) {
    using D = Dual<double, 1>;
    Gaussians<D> moved;
    convert_fields(moved, s.gaussians, [](double x) { return D(x); });
    Gaussians<D>::fields(
        [](const std::string&, Columns<D>& a, const Columns<double>& d) {
            for (Index i = 0; i < a.size(); ++i) a.data()[i].d[0] = d.data()[i];
        },
        moved, v);
    const VecX<D> background = s.background.cast<D>();
    const Raster<D> r =
        Rasterizer<A>{accuracy}.forward(Plain{}, moved, s.camera.cast<D>(), background);
    double sum = 0;
    const auto add = [&](const Columns<D>& a, const Columns<double>& b) {
        for (Index i = 0; i < a.size(); ++i) sum += a.data()[i].d[0] * b.data()[i];
    };
    add(r.feature.pixels, w.feature);
    add(r.alpha.pixels, w.alpha);
    add(r.depth.pixels, w.depth);
    return sum;
}

} // namespace

OracleImages truth(const Scenery<float>& s) { return true_images(s); }
OracleImages truth(const Scenery<double>& s) { return true_images(s); }

PlainImages<float> plain(const Scenery<float>& s, const Balanced& a) { return plain_images(s, a); }
PlainImages<float> plain(const Scenery<float>& s, const Compatible3dgs& a) {
    return plain_images(s, a);
}
PlainImages<float> plain(const Scenery<float>& s, const Compatible3dgsFloor& a) {
    return plain_images(s, a);
}
PlainImages<double> plain(const Scenery<double>& s, const Balanced& a) {
    return plain_images(s, a);
}

double slope(const Scenery<double>& s, const Balanced& a, const Gaussians<double>& v,
             const Weights<double>& w) {
    return slope_by_duals(s, a, v, w);
}
double slope(const Scenery<double>& s, const Compatible3dgs& a, const Gaussians<double>& v,
             const Weights<double>& w) {
    return slope_by_duals(s, a, v, w);
}
double slope(const Scenery<double>& s, const Compatible3dgsFloor& a, const Gaussians<double>& v,
             const Weights<double>& w) {
    return slope_by_duals(s, a, v, w);
}

Gaussians<double> plain_gradient(const Scenery<float>& s, const Balanced& a,
                                 const Weights<float>& w, bool extra) {
    const Scenery<double> d = in_double(s);
    const Rasterizer<> rasterizer{a};
    const auto raster = rasterizer.forward(Plain{}, d.gaussians, d.camera, d.background);
    const Columns<double> feature = w.feature.cast<double>();
    const Columns<double> alpha = w.alpha.cast<double>(), depth = w.depth.cast<double>();
    return rasterizer.vjp(Plain{}, d.gaussians, d.camera, d.background, raster, feature,
                          extra ? &alpha : nullptr, extra ? &depth : nullptr);
}

} // namespace rye::test
