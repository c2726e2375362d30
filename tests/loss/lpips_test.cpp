// SPDX-License-Identifier: Apache-2.0
#include <rye/loss/lpips.hpp>

#include <doctest/doctest.h>

#include <rye/backend/lanes.hpp>

#include "../support/laws.hpp"

using namespace rye;

static_assert(PerceptualLoss<LpipsVgg<float>>);

const XsimdBackend lanes;

namespace {

const VggShape tiny{3, {4, 5, 6, 7, 8}, {2, 2, 3, 3, 3}};

template <class T>
LpipsWeights<T> random_weights(std::uint64_t seed) {
    LpipsWeights<T> w(tiny);
    LpipsWeights<T>::fields(
        [&](const std::string& name, Columns<T>& a) {
            a = random_columns<T>(a.rows(), a.cols(), ++seed);
            if (name.starts_with("lin"))
                a = a.cwiseAbs();
            else if (name.ends_with(".weight"))
                a *= T(2 / std::sqrt(double(a.cols())));
            else
                a *= T(0.1);
        },
        w);
    return w;
}

template <class T>
Image<T> random_image(int width, int height, std::uint64_t seed) {
    Image<T> image(width, height, 3);
    image.pixels = (random_columns<T>(3, image.size(), seed).array() * T(0.5) + T(0.5)).matrix();
    return image;
}

/// One pixel of a layer by definition: a convolution of in(...), bias, ReLU.
template <class In>
Image<double> plain_layer(const Columns<double>& w, const Columns<double>& b, const In& in,
                          int width, int height, int channels) {
    Image<double> out(width, height, static_cast<int>(w.rows()));
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x)
            for (Index o = 0; o < w.rows(); ++o) {
                double sum = b(o);
                for (int k = 0; k < 9; ++k) {
                    const int u = x + k % 3 - 1, v = y + k / 3 - 1;
                    if (u < 0 || v < 0 || u >= width || v >= height) continue;
                    for (int c = 0; c < channels; ++c) sum += w(o, k * channels + c) * in(u, v, c);
                }
                out.at(x, y)(o) = std::max(sum, 0.0);
            }
    return out;
}

/// LPIPS written out for whole images, without rye's layers.
double plain_lpips(const LpipsWeights<double>& w, const Image<double>& a, const Image<double>& b) {
    const double shift[] = {-.030, -.088, -.188}, scale[] = {.458, .448, .450};
    Image<double> x[2] = {a, b};
    for (Image<double>& image : x)
        for (Index j = 0; j < image.size(); ++j)
            for (int c = 0; c < 3; ++c)
                image.pixels(c, j) = (2 * image.pixels(c, j) - 1 - shift[c]) / scale[c];
    double total = 0;
    std::size_t l = 0;
    for (std::size_t s = 0; s < 5; ++s) {
        for (int k = 0; k < tiny.convolutions[s]; ++k, ++l)
            for (Image<double>& image : x) {
                const Image<double> in = image;
                const bool pool = s > 0 && k == 0;
                const auto value = [&](int u, int v, int c) {
                    if (!pool) return in.at(u, v)(c);
                    return std::max({in.at(2 * u, 2 * v)(c), in.at(2 * u + 1, 2 * v)(c),
                                     in.at(2 * u, 2 * v + 1)(c), in.at(2 * u + 1, 2 * v + 1)(c)});
                };
                image =
                    plain_layer(w.net.weight[l], w.net.bias[l], value, in.width / (pool ? 2 : 1),
                                in.height / (pool ? 2 : 1), in.channels());
            }
        double sum = 0;
        for (Index j = 0; j < x[0].size(); ++j) {
            const VecX<double> p = x[0].pixels.col(j) / (x[0].pixels.col(j).norm() + 1e-10);
            const VecX<double> q = x[1].pixels.col(j) / (x[1].pixels.col(j).norm() + 1e-10);
            sum += (p - q).cwiseAbs2().dot(w.linear[s].col(0));
        }
        total += sum / static_cast<double>(x[0].size());
    }
    return total;
}

} // namespace

TEST_CASE("vgg: the published number of parameters, under torchvision's names") {
    const Vgg<float> net;
    CHECK(count_fields(net) == 14714688);
    std::vector<std::string> names;
    Vgg<float>::fields([&](const std::string& n, const auto&) { names.push_back(n); }, net);
    REQUIRE(names.size() == 26);
    CHECK(names[2] == "features.2.weight");
    CHECK(names[4] == "features.5.weight");
    CHECK(names[25] == "features.28.bias");
}

TEST_CASE("lpips: equals the definition, also for odd sizes; 0 for equal images") {
    const LpipsVgg<double> loss{random_weights<double>(1)};
    for (const auto& [w, h] : {std::pair(32, 32), {37, 21}}) {
        const Image<double> a = random_image<double>(w, h, 1), b = random_image<double>(w, h, 2);
        CHECK(loss(lanes, a, b).value ==
              doctest::Approx(plain_lpips(loss.weights, a, b)).epsilon(1e-12));
        CHECK(loss.value(lanes, a, b) == loss(lanes, a, b).value);
        CHECK(loss(lanes, a, a).value == 0);
        CHECK(loss(lanes, a, a).gradient.isZero(0));
    }
}

TEST_CASE("lpips: the gradient is that of duals") {
    const auto check = []<class T>(T, double tolerance) {
        const LpipsVgg<T> loss{random_weights<T>(1)};
        LpipsVgg<Dual<T, 1>> dual{LpipsWeights<Dual<T, 1>>(tiny)};
        convert_fields(dual.weights, loss.weights, [](T x) { return Dual<T, 1>(x); });
        const Image<T> a = random_image<T>(35, 18, 1), b = random_image<T>(35, 18, 2);
        const Columns<T> da = random_columns<T>(3, a.size(), 3);
        Image<Dual<T, 1>> ad(35, 18, 3), bd(35, 18, 3);
        ad.pixels = lifted(a.pixels, da);
        bd.pixels = b.pixels.template cast<Dual<T, 1>>();
        const Dual<T, 1> value = dual(ScalarBackend{}, ad, bd).value;
        const LossGradient<T> got = loss(lanes, a, b);
        CHECK(value.value == doctest::Approx(got.value).epsilon(1e-5));
        const Columns<T> terms = got.gradient.cwiseProduct(da);
        CHECK(double(terms.cwiseAbs().sum()) > 1e-4);
        CHECK(double(std::abs(value.d[0] - terms.sum()) / terms.cwiseAbs().sum()) < tolerance);
    };
    check(double(), 1e-13);
    check(float(), 1e-5);
}

TEST_CASE("lpips: features that are all zero give no NaN") {
    LpipsVgg<float> loss{random_weights<float>(1)};
    loss.weights.net.bias.back().setConstant(-100.0f);
    const auto got = loss(lanes, random_image<float>(32, 32, 1), random_image<float>(32, 32, 2));
    CHECK(std::isfinite(got.value));
    CHECK(got.gradient.allFinite());
}

TEST_CASE("lpips: images too small or of other channels are refused") {
    const LpipsVgg<float> loss{random_weights<float>(1)};
    CHECK_THROWS_AS(loss(lanes, random_image<float>(15, 32, 1), random_image<float>(15, 32, 1)),
                    Error);
    CHECK_THROWS_AS(loss(lanes, Image<float>(32, 32, 4), Image<float>(32, 32, 4)), Error);
}
