// SPDX-License-Identifier: Apache-2.0
#include <rye/nn/convolution.hpp>

#include <doctest/doctest.h>

#include <rye/backend/lanes.hpp>
#include <rye/backend/scalar.hpp>

#include "../support/random.hpp"

using namespace rye;

TEST_CASE("convolution: the adjoint of the adjoint weights are the weights") {
    const Columns<double> w = random_columns<double>(5, 9 * 3, 1);
    CHECK(adjoint_weight3x3(adjoint_weight3x3(w)) == w);
}

TEST_CASE("convolution: the same bits with any kind of threads") {
    const Image<float> in = random_image<float>(150, 170, 8, 1),
                       g = random_image<float>(150, 170, 16, 2);
    const Columns<float> w = random_columns<float>(16, 72, 3);
    const auto run = [&]<class B>(B) {
        Columns<float> gw = Columns<float>::Zero(16, 72);
        convolve3x3_vjp_weight(B{}, padded(B{}, in), padded(B{}, g), gw);
        return std::pair{gw, convolve3x3(B{}, w, padded(B{}, in)).pixels};
    };
    CHECK(run(XsimdBackend<DefaultArch, Serial>{}) ==
          run(XsimdBackend<DefaultArch, DefaultThreads>{}));
}
