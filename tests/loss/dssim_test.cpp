// SPDX-License-Identifier: Apache-2.0
#include <rye/loss/dssim.hpp>

#include <doctest/doctest.h>

#include <rye/backend/scalar.hpp>

#include "../support/laws.hpp"

using namespace rye;

namespace {

using B = ScalarBackend<>;

template <class T>
Image<T> image_of(int width, int height, std::uint64_t seed) {
    Image<T> image(width, height, 3);
    image.pixels = (random_columns<T>(3, width * height, seed).array() * T(0.5) + T(0.5)).matrix();
    return image;
}

template <class T>
double law_error(int width, int height) {
    const Image<T> a = image_of<T>(width, height, 1), b = image_of<T>(width, height, 2);
    const Columns<T> da = random_columns<T>(3, a.size(), 3);
    Image<Dual<T, 1>> x(width, height, 3), y(width, height, 3);
    x.pixels = lifted(a.pixels, da);
    y.pixels = lifted(b.pixels, Columns<T>(Columns<T>::Zero(3, b.size())));
    DotProducts d;
    const Columns<T> slope = Columns<T>::Constant(1, 1, dssim<Dual<T, 1>>(B{}, x, y).value.d[0]);
    d.add_forward(slope, Columns<T>(Columns<T>::Ones(1, 1)));
    d.add_reverse(dssim<T>(B{}, a, b).gradient, da);
    return d.error();
}

/// The same in the middle of a black canvas.
Image<double> framed(const Image<double>& image) {
    constexpr int edge = detail::ssim_window / 2;
    Image<double> out(image.width + 2 * edge, image.height + 2 * edge, 3);
    out.pixels.setZero();
    for (int y = 0; y < image.height; ++y)
        for (int x = 0; x < image.width; ++x) out.at(x + edge, y + edge) = image.at(x, y);
    return out;
}

} // namespace

TEST_CASE("D-SSIM is 1 - SSIM, with black around the images") {
    const Image<double> a = image_of<double>(23, 17, 4), b = image_of<double>(23, 17, 5);
    const double measured = ssim(B{}, framed(a), framed(b), Columns<double>());
    CHECK(dssim<double>(B{}, a, b).value == doctest::Approx(1 - measured).epsilon(1e-12));
    CHECK(dssim<double>(B{}, a, a).value == doctest::Approx(0).epsilon(1e-12));
}

TEST_CASE("D-SSIM: its gradient is what duals give") {
    CHECK(law_error<double>(19, 14) <= 1e-12);
    CHECK(law_error<float>(19, 14) <= 1e-5);
    CHECK(law_error<double>(5, 3) <= 1e-12);  // smaller than the window
}

TEST_CASE("D-SSIM of flat pictures has a finite gradient") {
    Image<float> a(12, 12, 3), b(12, 12, 3);
    a.pixels.setZero();
    b.pixels.setOnes();
    CHECK(dssim<float>(B{}, a, b).gradient.allFinite());
    b.pixels.setZero();
    CHECK(dssim<float>(B{}, a, b).gradient.isZero(1e-6F));
}

TEST_CASE("D-SSIM: by hand, a picture of one pixel") {
    // The window's middle weight is 1 / (1 + 2 sum exp(-i^2 / 4.5), i = 1..5) = 0.266012, in two
    // dimensions w = 0.0707623; all around is 0. For a = 0.5 and b = 0.25 the means are w / 2 and
    // w / 4, the mean squares w / 4 and w / 16, the mean product w / 8:
    //   (2 w^2 / 8 + 1e-4) / (w^2 / 4 + w^2 / 16 + 1e-4) = 0.812014
    //   (2 (w / 8 - w^2 / 8) + 9e-4) / (w / 4 + w / 16 - w^2 / 4 - w^2 / 16 + 9e-4) = 0.808392
    Image<double> a(1, 1, 3, 0.5), b(1, 1, 3, 0.25);
    CHECK(dssim<double>(B{}, a, b).value == doctest::Approx(1 - 0.812014 * 0.808392).epsilon(1e-5));
    // Nothing against white: the means are 0 and w, the variances 0 and w - w^2.
    a.pixels.setZero();
    b.pixels.setOnes();
    const double w = 0.0707623;
    CHECK(dssim<double>(B{}, a, b).value ==
          doctest::Approx(1 - 1e-4 / (w * w + 1e-4) * 9e-4 / (w - w * w + 9e-4)).epsilon(1e-6));
}
