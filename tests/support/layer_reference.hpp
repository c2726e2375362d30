// SPDX-License-Identifier: Apache-2.0
/// tests/support/layer_reference.hpp: derivatives of networks by duals through plain loops, the
/// reference of those in lanes. Compiled once, for all widths.
#pragma once

#include <rye/nn/mlp.hpp>
#include <rye/nn/upsampler.hpp>

namespace rye::test {

/// Point and direction of a network's derivative, and the weights of its outputs.
template <class P>
struct Probe {
    P network, d_network;
    Columns<double> in, d_in, weights;
    VecX<double> frame, d_frame;         ///< of an Mlp
    int width = 0, height = 0;           ///< of an upsampler's input
};

/// Output of a network, and <weights, J d>.
struct Answer {
    Columns<double> out;
    double slope;
};
Answer answer(const Probe<Mlp<double>>& p);
Answer answer(const Probe<Upsampler<double>>& p);

} // namespace rye::test
