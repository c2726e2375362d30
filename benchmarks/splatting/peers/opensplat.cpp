// SPDX-License-Identifier: Apache-2.0
// opensplat.cpp: calls OpenSplat's rasterizer of the CPU as its training does. Colours are given,
// not made from harmonics.
#include <ctime>

#include "project_gaussians.hpp"
#include "rasterize_gaussians.hpp"

#include "peer.hpp"

namespace peers {

namespace {

torch::Tensor mean, scale, rotation, opacity, colour, view, projection, background;
Scene scene;

/// CPU time of all threads [s]: were there several, each would count.
double seconds() {
    std::timespec t{};
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

torch::Tensor tensor(const float* from, std::vector<std::int64_t> shape) {
    return torch::from_blob(const_cast<float*>(from), shape, torch::kFloat32).clone();
}

std::vector<float> numbers(const torch::Tensor& of) {
    const torch::Tensor t = of.contiguous();
    return std::vector<float>(t.data_ptr<float>(), t.data_ptr<float>() + t.numel());
}

variable_list project() {
    return ProjectGaussiansCPU::apply(mean, scale, 1, rotation, view, projection, scene.fx,
                                      scene.fy, scene.cx, scene.cy, scene.height, scene.width);
}

} // namespace

std::string version() { return "OpenSplat " PEER_COMMIT ", libtorch " TORCH_VERSION; }

void prepare(const Scene& s) {
    torch::set_num_threads(1);
    torch::manual_seed(1);
    scene = s;
    mean = tensor(s.mean, {s.count, 3}).requires_grad_();
    scale = tensor(s.scale, {s.count, 3}).requires_grad_();
    rotation = tensor(s.rotation, {s.count, 4}).requires_grad_();
    opacity = tensor(s.opacity, {s.count, 1}).requires_grad_();
    colour = tensor(s.colour, {s.count, 3}).requires_grad_();
    view = tensor(s.view, {4, 4});
    background = torch::zeros({3});
    // Its order is that of floats after the projection, so the near plane is not as near as its
    // training's (0.001), at which many of these depths would be equal.
    const float far = 1000;
    projection = torch::zeros({4, 4});
    projection[0][0] = 2 * s.fx / static_cast<float>(s.width);
    projection[1][1] = 2 * s.fy / static_cast<float>(s.height);
    projection[2][2] = far / (far - s.near);
    projection[2][3] = -far * s.near / (far - s.near);
    projection[3][2] = 1;
    projection = torch::matmul(projection, view);
}

Seconds forward(Picture* picture) {
    const torch::NoGradGuard without;
    const double begin = seconds();
    const variable_list p = project();
    const double middle = seconds();
    const auto [image, transmittance, lists] = rasterize_forward_tensor_cpu(
        scene.width, scene.height, p[0], p[2], colour, opacity, background, p[3], p[4]);
    const double end = seconds();
    delete[] lists;
    if (picture != nullptr) *picture = numbers(image);
    return {middle - begin, end - begin};
}

double both(const Picture& cotangent, Gradient* gradient) {
    const torch::Tensor g = tensor(cotangent.data(), {scene.height, scene.width, 3});
    for (torch::Tensor* t : {&mean, &scale, &rotation, &opacity, &colour})
        t->mutable_grad().reset();
    const double begin = seconds();
    const variable_list p = project();
    const torch::Tensor image = RasterizeGaussiansCPU::apply(
        p[0], p[1], p[2], colour, opacity, p[3], p[4], scene.height, scene.width, background);
    image.backward(g);
    const double time = seconds() - begin;
    if (gradient != nullptr)
        *gradient = {numbers(mean.grad()), numbers(scale.grad()), numbers(rotation.grad()),
                     numbers(opacity.grad()), numbers(colour.grad())};
    return time;
}

} // namespace peers
