// SPDX-License-Identifier: Apache-2.0
/// rye/splat/plain/jvp.hpp: the derivative of a render in a direction: the render itself, on duals.
#pragma once

#include <rye/backend/scalar.hpp>
#include <rye/splat/tangents.hpp>

namespace rye {

/// Rasterizer::jvp by plain loops. R: a Rasterizer<A>.
template <class R, Backend B, class T, Distortion D, Outputs O>
void jvp_by_duals(const R& rasterizer, const B& backend, const RasterJvpInput<T, D>& in,
                  RasterJvp<T, O>& out) {
    using Number = Dual<T, 1>;
    const GaussianView<T>& g = in.gaussians;
    const RasterTangents<T, D>& tangents = in.tangents;
    Gaussians<Number> dual(g.count(), g.channels());
    const Gaussians<T>* const moves = tangents.gaussians;
    const auto lift = [&](Columns<Number>& to, Index i, const T* x, const Columns<T>* dx) {
        for (Index k = 0; k < to.rows(); ++k)
            to(k, i) = detail::dual_of<T>(x[k], dx != nullptr ? (*dx)(k, i) : T(0));
    };
    for (Index i = 0; i < g.count(); ++i) {
        lift(dual.mean, i, g.mean(i), moves != nullptr ? &moves->mean : nullptr);
        lift(dual.rotation, i, g.rotation(i), moves != nullptr ? &moves->rotation : nullptr);
        lift(dual.scale, i, g.scale(i), moves != nullptr ? &moves->scale : nullptr);
        lift(dual.opacity, i, g.opacity(i), moves != nullptr ? &moves->opacity : nullptr);
        lift(dual.feature, i, g.feature_of(i), moves != nullptr ? &moves->feature : nullptr);
    }
    const ScalarBackend plain{backend.threads};
    const auto raster =
        rasterizer.forward(plain, dual, detail::dual_camera<T>(in.camera, tangents.camera),
                           VecX<Number>(in.background.template cast<Number>()));
    const auto split = [](const Image<Number>& x, Image<T>& value, Columns<T>& tangent) {
        value.width = x.width;
        value.height = x.height;
        value.pixels = x.pixels.unaryExpr([](const Number& v) { return v.value; });
        tangent = x.pixels.unaryExpr([](const Number& v) { return v.d[0]; });
    };
    split(raster.feature, out.value.feature, out.feature);
    split(raster.alpha, out.value.alpha, out.alpha);
    if constexpr (O.depth) split(raster.depth, out.value.depth, out.depth);
    if constexpr (O.contributor) out.value.contributor = raster.contributor;
}

} // namespace rye
