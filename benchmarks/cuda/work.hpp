// SPDX-License-Identifier: Apache-2.0
/// benchmarks/cuda/work.hpp: products of two numbers that networks of points and of images ask for,
/// forward; all their gradients are twice as many again.
#pragma once

#include <cmath>

#include <rye/nn/mlp.hpp>
#include <rye/nn/upsampler.hpp>

namespace rye::bench {

/// Products of a point. What all points of a frame share is not counted.
inline double products(const MlpShape& s) {
    double sum = 0;
    for (int l = 0; l < s.layers(); ++l)
        sum +=
            double(s.layer_out(l)) * (s.hidden_in(l) + (s.reads_input(l) ? s.point_inputs() : 0));
    return sum;
}

/// Products of the convolutions of a picture of so many pixels of features.
inline double products(const UpsamplerShape& s, double pixels) {
    double sum = 0;
    for (int l = 0; l < s.layers(); ++l)
        sum += 9 * std::ldexp(pixels, l / 2 * 2) * s.layer_in(l) * s.block_out(l / 2);
    return sum;
}

} // namespace rye::bench
