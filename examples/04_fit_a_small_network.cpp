// SPDX-License-Identifier: Apache-2.0
// Lesson 4: training. A parameter struct names its arrays once, in fields(); gradients and the
// optimiser's moments are further objects of the same struct, visited together.
#include <cmath>
#include <cstdio>

#include <rye/backend/lanes.hpp>
#include <rye/core/random.hpp>
#include <rye/nn/adam.hpp>
#include <rye/nn/encoding.hpp>
#include <rye/nn/mlp.hpp>

using namespace rye;

int main() {
    using B = XsimdBackend<>;
    const Index n = 1024;
    const Random random{.seed = 7};

    // The function to learn: a wave over the square, sampled at n points.
    Columns<float> points(2, n), target(1, n);
    for (Index i = 0; i < n; ++i) {
        const auto k = static_cast<std::uint64_t>(i);
        points(0, i) = float(2 * random.uniform(2 * k) - 1);
        points(1, i) = float(2 * random.uniform(2 * k + 1) - 1);
        target(0, i) = std::sin(3 * points(0, i)) * std::cos(2 * points(1, i));
    }

    const Columns<float> encoded = positional_encoding(points, 2);  // 10 x n
    const VecX<float> frame;                    // no inputs that all points share
    Mlp<float> network = Mlp<float>::init({.dims = {10, 32, 32, 1}}, random.fork(1));
    std::printf("a network of %td numbers:\n", count_fields(network));
    Mlp<float>::fields(
        [](const std::string& name, const Columns<float>& a) {
            std::printf("  %-14s %3td x %td\n", name.c_str(), a.rows(), a.cols());
        },
        network);

    Adam<Mlp<float>> adam(network);
    MlpTrace<float> trace;
    double first = 0, loss = 0;
    for (int step = 0; step <= 400; ++step) {
        const Columns<float> y = mlp_forward(B{}, network, encoded, frame, &trace);
        const Columns<float> error = y - target;                    // d(loss)/dy = 2 error / n
        loss = static_cast<double>(error.squaredNorm()) / static_cast<double>(n);
        if (step == 0) first = loss;
        if (step % 100 == 0) std::printf("step %3d: mean squared error %.6f\n", step, loss);

        Mlp<float> gradient = zeros_like(network);
        mlp_vjp(B{}, network, {encoded, frame, trace}, Columns<float>(error * (2.0f / float(n))),
                {.params = gradient});
        adam_step(B{}, network, gradient, adam, [](const std::string&) { return 1e-2; });
    }
    return loss < 0.01 * first ? 0 : 1;
}
