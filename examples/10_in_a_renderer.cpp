// SPDX-License-Identifier: Apache-2.0
// Lesson 10: rye inside a renderer. Its camera is the renderer's OpenGL matrices, its Gaussians are
// the renderer's own vertices, read where they are, and its calls need no backend.
#include <cstdio>
#include <vector>

#include <rye/geometry/opengl.hpp>
#include <rye/splat/lanes.hpp>

using namespace rye;

/// A splat as the renderer stores it: in its own order, with fields that rye does not read.
struct Vertex {
    float rgb[3];
    float age;
    float position[3];
    float opacity;
    float rotation[4]; // (w, x, y, z)
    float scale[3];
};

/// A view of vertices: addresses and a stride, no copy.
GaussianView<float> view_of(const std::vector<Vertex>& vertices) {
    constexpr Index stride = stride_in<float, Vertex>();
    const Vertex& first = vertices.front();
    GaussianView<float> view;
    view.mean = {first.position, stride};
    view.rotation = {first.rotation, stride};
    view.scale = {first.scale, stride};
    view.opacity = {&first.opacity, stride};
    view.feature = first.rgb;
    view.stride = stride;
    view.rows = 3;
    view.size = static_cast<Index>(vertices.size());
    return view;
}

int main() {
    // Column-major, as glUniformMatrix4fv takes them: 4 in front of the origin, 53 degrees high.
    const float view_matrix[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, -4, 1};
    const float projection[16] = {2, 0, 0, 0, 0, 2, 0, 0, 0, 0, -1.002f, -1, 0, 0, -0.2002f, 0};
    using Matrix = Eigen::Map<const Mat<float, 4, 4>>;
    const Pinhole<float> camera =
        pinhole_from_opengl<float>(Matrix(view_matrix), Matrix(projection), 64, 64);
    std::printf("focal length %.1f px, near plane at %.3f\n", camera.fx, camera.near_depth);

    const std::vector<Vertex> vertices{
        {{1, 0.2f, 0.1f}, 0, {0, 0.3f, 0}, 0.9f, {1, 0, 0, 0}, {0.3f, 0.1f, 0.1f}},
        {{0.1f, 0.4f, 1}, 7, {0, -0.4f, 0}, 0.9f, {1, 0, 0, 0}, {0.1f, 0.1f, 0.1f}}};
    const GaussianView<float> view = view_of(vertices);
    const bool shared = view.mean(1) == vertices[1].position;
    std::printf("vertex 1 at %p, rye reads it at %p\n",
                static_cast<const void*>(vertices[1].position),
                static_cast<const void*>(view.mean(1)));

    const VecX<float> black = VecX<float>::Zero(3);
    const Rasterizer rasterizer;
    const auto raster = rasterizer.forward(view, camera, black); // lanes, on OpenMP's threads
    const auto gradient = rasterizer.vjp(view, camera, black, raster, raster.feature.pixels);
    // y is up in the world: the red vertex is in the upper half of the picture.
    const float upper = raster.feature.at(32, 27)[0], lower = raster.feature.at(32, 38)[2];
    std::printf("red above %.2f, blue below %.2f, d loss / d red of vertex 0 %.2f\n", upper, lower,
                gradient.feature(0, 0));
    return shared && upper > 0.5f && lower > 0.5f && gradient.feature(0, 0) > 0 ? 0 : 1;
}
