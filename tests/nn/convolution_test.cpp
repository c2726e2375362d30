// SPDX-License-Identifier: Apache-2.0
#include <rye/nn/convolution.hpp>

#include <doctest/doctest.h>

#include <rye/backend/lanes.hpp>
#include <rye/backend/scalar.hpp>

#include "adjoint.hpp"

using namespace rye;

namespace {

template <class T>
Image<T> random_image(int width, int height, int channels, std::uint64_t seed) {
    Image<T> image(width, height, channels);
    image.pixels = random_columns<T>(channels, image.size(), seed);
    return image;
}

/// The definition, element by element.
template <class T>
Image<T> plain_convolution(const Columns<T>& weight, const Image<T>& in) {
    Image<T> out(in.width, in.height, static_cast<int>(weight.rows()));
    for (int y = 0; y < in.height; ++y)
        for (int x = 0; x < in.width; ++x)
            for (int ky = 0; ky < 3; ++ky)
                for (int kx = 0; kx < 3; ++kx) {
                    const int u = x + kx - 1, v = y + ky - 1;
                    if (u < 0 || v < 0 || u >= in.width || v >= in.height) continue;
                    out.at(x, y) +=
                        weight.middleCols((3 * ky + kx) * in.channels(), in.channels()) *
                        in.at(u, v);
                }
    return out;
}

struct Size {
    int width, height, in, out;
};
const Size sizes[] = {{7, 5, 3, 4},    {1, 1, 2, 2},   {1, 9, 1, 8},   {33, 2, 8, 8},
                      {40, 20, 16, 9}, {25, 9, 5, 32}, {64, 3, 32, 16}};

} // namespace

TEST_CASE_TEMPLATE("convolution: equals its definition", B, ScalarBackend<>, XsimdBackend<>) {
    for (const Size& s : sizes) {
        CAPTURE(s.width);
        CAPTURE(s.out);
        const Columns<double> w = random_columns<double>(s.out, 9 * s.in, 1);
        const Image<double> in = random_image<double>(s.width, s.height, s.in, 2);
        const Image<double> expected = plain_convolution(w, in);
        CHECK(
            (convolve3x3(B{}, w, padded(B{}, in)).pixels - expected.pixels).cwiseAbs().maxCoeff() <
            1e-12);
        const Columns<float> wf = w.cast<float>();
        Image<float> inf(s.width, s.height, s.in);
        inf.pixels = in.pixels.cast<float>();
        const Image<float> got = convolve3x3(B{}, wf, padded(B{}, inf));
        CHECK((got.pixels.cast<double>() - expected.pixels).cwiseAbs().maxCoeff() < 2e-5);
    }
}

TEST_CASE_TEMPLATE("convolution: the vjps are adjoints", B, ScalarBackend<>, XsimdBackend<>) {
    const auto check = []<class T>(T, const Size& s, double tolerance) {
        const Columns<T> w = random_columns<T>(s.out, 9 * s.in, 1);
        const Columns<T> dw = random_columns<T>(s.out, 9 * s.in, 2);
        const Image<T> in = random_image<T>(s.width, s.height, s.in, 3);
        const Image<T> din = random_image<T>(s.width, s.height, s.in, 4);
        const Image<T> g = random_image<T>(s.width, s.height, s.out, 5);
        Columns<T> gw = Columns<T>::Zero(s.out, 9 * s.in);
        convolve3x3_vjp_weight(B{}, padded(B{}, in), padded(B{}, g), gw);
        DotProducts dots; // bilinear, so the derivative is two products
        dots.add_forward(plain_convolution(dw, in).pixels, g.pixels);
        dots.add_forward(plain_convolution(w, din).pixels, g.pixels);
        dots.add_reverse(gw, dw);
        dots.add_reverse(convolve3x3_vjp_input(B{}, w, g).pixels, din.pixels);
        CHECK(dots.error() < tolerance);
    };
    for (const Size& s : sizes) {
        CAPTURE(s.width);
        CAPTURE(s.out);
        check(double(), s, 1e-14);
        check(float(), s, 2e-6);
    }
}

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
