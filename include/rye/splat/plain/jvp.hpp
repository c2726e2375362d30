// SPDX-License-Identifier: Apache-2.0
/// rye/splat/plain/jvp.hpp: the derivative of a render in a direction: the render itself, on duals.
#pragma once

#include <rye/backend/scalar.hpp>
#include <rye/splat/tangents.hpp>

namespace rye {

/// Rasterizer::jvp by plain loops. R: a Rasterizer<A>.
template <class R, Backend B, class T, Distortion D, Outputs O>
void jvp_by_duals(const R& rasterizer, const B& backend, const Gaussians<T>& g,
                  const RasterTangents<T, D>& tangents, const Pinhole<T, D>& camera,
                  const VecX<T>& background, RasterJvp<T, O>& out) {
    using Number = Dual<T, 1>;
    Gaussians<Number> dual;
    const Gaussians<T> still;
    Gaussians<Number>::fields(
        [&](const std::string&, Columns<Number>& to, const Columns<T>& x, const Columns<T>& dx) {
            to.resize(x.rows(), x.cols());
            const bool moves = tangents.gaussians != nullptr;
            for (Index i = 0; i < x.size(); ++i)
                to.data()[i] = dual_of<T>(x.data()[i], moves ? dx.data()[i] : T(0));
        },
        dual, g, tangents.gaussians != nullptr ? *tangents.gaussians : still);
    const ScalarBackend plain{backend.threads};
    const auto raster = rasterizer.forward(plain, dual, dual_camera<T>(camera, tangents.camera),
                                           VecX<Number>(background.template cast<Number>()));
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
