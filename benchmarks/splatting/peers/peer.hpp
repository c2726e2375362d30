// SPDX-License-Identifier: Apache-2.0
/// benchmarks/splatting/peers/peer.hpp: a rasterizer of other people, called for the timed scene.
/// No types of rye, Eigen or PyTorch: each side compiles by the flags and the standard it wants.
#pragma once

#include <string>
#include <vector>

namespace peers {

/// Gaussians of three colours, one after the other, and a pinhole camera. Quaternions are w, x, y,
/// z of length one, and `view` is world to camera, by rows.
struct Scene {
    int count;
    const float *mean, *scale, *rotation, *opacity, *colour;
    int width, height;
    float fx, fy, cx, cy, near;
    float view[16];
};

/// A picture, pixel by pixel.
using Picture = std::vector<float>;

/// What the derivative of a loss is by each array of the scene.
struct Gradient {
    std::vector<float> mean, scale, rotation, opacity, colour;
};

/// CPU times of a call [s]; memory that it gives back after the picture is not counted.
struct Seconds {
    double project;   ///< to the picture's plane
    double forward;   ///< all of a picture
};

std::string version();
/// Makes the scene's tensors.
void prepare(const Scene& scene);
/// Draws without what gradients need, and writes the picture if there is one to write to.
Seconds forward(Picture* picture);
/// Draws, and writes the gradient of everything if there is one to write to; returns CPU time [s].
double both(const Picture& cotangent, Gradient* gradient);

} // namespace peers
