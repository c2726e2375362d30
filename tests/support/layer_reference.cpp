// SPDX-License-Identifier: Apache-2.0
#include "layer_reference.hpp"

#include <rye/backend/scalar.hpp>

#include "laws.hpp"

namespace rye::test {

namespace {

using D = Dual<double, 1>;
using Plain = ScalarBackend<Serial>;

Answer split(const Columns<D>& y, const Columns<double>& weights) {
    return {values(y), tangents(y).cwiseProduct(weights).sum()};
}

} // namespace

Answer answer(const Probe<Mlp<double>>& p) {
    Mlp<D> m(p.network.shape);
    lift_fields(m, p.network, p.d_network);
    const VecX<D> frame = lifted<double>(p.frame, p.d_frame);
    return split(mlp_forward(Plain{}, m, lifted(p.in, p.d_in), frame, nullptr), p.weights);
}

Answer answer(const Probe<Upsampler<double>>& p) {
    Upsampler<D> u(p.network.shape);
    lift_fields(u, p.network, p.d_network);
    Image<D> in(p.width, p.height, p.network.shape.in_channels);
    in.pixels = lifted(p.in, p.d_in);
    return split(upsampler_forward(Plain{}, u, in, nullptr).pixels, p.weights);
}

} // namespace rye::test
