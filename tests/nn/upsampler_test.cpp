// SPDX-License-Identifier: Apache-2.0
#include <rye/nn/upsampler.hpp>

#include <doctest/doctest.h>

#include <rye/backend/lanes.hpp>
#include <rye/backend/scalar.hpp>

#include "../support/random.hpp"

using namespace rye;

namespace {

UpsamplerShape shape(int in, int capacity, int doublings, Normalization norm, bool skip) {
    return {in, capacity, doublings, norm, skip};
}

/// A square of noise, the iris, in the middle of other features: a face's, or white.
Image<float> iris_on(const Image<float>& around) {
    Image<float> in = around;
    const Image<float> iris = random_image<float>(12, 12, in.channels(), 3);
    for (int y = 0; y < 12; ++y)
        for (int x = 0; x < 12; ++x) in.at(10 + x, 10 + y) = iris.at(x, y);
    return in;
}

/// How far the colours of an iris in the whole picture are from those of the same features in the
/// picture of the eyes alone, at most, in the part of it that convolutions see nothing else from.
float iris_gap(const UpsamplerShape& s) {
    const Upsampler<float> u = Upsampler<float>::init(s, Random{1, 0});
    const auto shown = [&](const Image<float>& around) {
        return upsampler_forward(XsimdBackend<>{}, u, iris_on(around), nullptr);
    };
    const Image<float> whole = shown(random_image<float>(32, 32, s.in_channels, 4));
    const Image<float> alone = shown(Image<float>(32, 32, s.in_channels, 1.0f));
    float gap = 0;
    for (int y = 15 << s.doublings; y < 17 << s.doublings; ++y)
        for (int x = 15 << s.doublings; x < 17 << s.doublings; ++x)
            gap = std::max(gap, (whole.at(x, y) - alone.at(x, y)).cwiseAbs().maxCoeff());
    return gap;
}

} // namespace

TEST_CASE("upsampler: parameter counts of the published network") {
    for (const auto& [capacity, count] : {std::pair(32, 322659), {64, 1216707}, {128, 4718979}}) {
        const Upsampler<float> u(UpsamplerShape{32, capacity});
        CHECK(count_fields(u) == count);
    }
    const Upsampler<float> u(UpsamplerShape{32, 32});
    std::vector<std::pair<std::string, Index>> sizes;
    detail::nested_fields<Upsampler<float>>(
        "upsampler", [&](const std::string& n, const auto& a) { sizes.emplace_back(n, a.size()); },
        u);
    const std::vector<std::pair<std::string, Index>> expected{
        {"upsampler.inc.double_conv.0.weight", 9 * 32 * 128},
        {"upsampler.inc.double_conv.3.weight", 9 * 128 * 128},
        {"upsampler.up1.conv.double_conv.0.weight", 9 * 128 * 64},
        {"upsampler.up1.conv.double_conv.3.weight", 9 * 64 * 64},
        {"upsampler.up2.conv.double_conv.0.weight", 9 * 64 * 32},
        {"upsampler.up2.conv.double_conv.3.weight", 9 * 32 * 32},
        {"upsampler.outc.conv.weight", 96},
        {"upsampler.outc.conv.bias", 3}};
    CHECK(sizes == expected);
}

TEST_CASE("upsampler: sizes, range, and a constant input") {
    const UpsamplerShape s{8, 4, 2};
    const Upsampler<float> u = Upsampler<float>::init(s, Random{1, 0});
    const Image<float> y =
        upsampler_forward(XsimdBackend<>{}, u, random_image<float>(6, 9, 8, 1), nullptr);
    CHECK(y.width == 24);
    CHECK(y.height == 36);
    CHECK(y.pixels.minCoeff() > 0);
    CHECK(y.pixels.maxCoeff() < 1);
    CHECK(upsampler_forward(XsimdBackend<>{}, u, Image<float>(6, 9, 8, 1.0f), nullptr)
              .pixels.allFinite());
    CHECK(upsampler_forward(XsimdBackend<>{}, u, Image<float>(1, 1, 8, 1.0f), nullptr)
              .pixels.allFinite());
}

TEST_CASE("upsampler: with the skip, training starts at the doubled image") {
    UpsamplerShape s{8, 4, 1};
    s.skip = true;
    Image<float> in = random_image<float>(6, 9, 8, 1);
    in.pixels = (in.pixels.array() * 0.4f + 0.5f).matrix();
    Image<float> rgb(6, 9, 3);
    rgb.pixels = in.pixels.topRows(3);
    const Upsampler<float> u = Upsampler<float>::init(s, Random{1, 0});
    const Image<float> y = upsampler_forward(XsimdBackend<>{}, u, in, nullptr);
    CHECK((y.pixels - doubled(XsimdBackend<>{}, rgb).pixels).cwiseAbs().maxCoeff() < 1e-6f);
}

TEST_CASE("upsampler: InstanceNorm gives the same iris another colour beside other pixels") {
    // The mean and variance are those of the whole picture, so the eye term of the final size,
    // which super-resolves the eyes alone, trains another function than the one that is shown.
    for (const int doublings : {0, 1, 2}) {
        CAPTURE(doublings);
        CHECK(iris_gap(shape(8, 4, doublings, Normalization::instance, false)) > 0.02f);
        CHECK(iris_gap(shape(8, 4, doublings, Normalization::none, false)) < 1e-6f);
    }
}

TEST_CASE("upsampler: odds times the base are the sigmoid of the sum of logits") {
    for (const double b : {0.001, 0.2, 0.5, 0.999})
        for (const double z : {-700.0, -3.0, 0.0, 2.0, 700.0})
            CHECK(detail::odds_sigmoid(b, z) ==
                  doctest::Approx(sigmoid(z + logit(b))).epsilon(1e-12));
}

TEST_CASE("upsampler: the same bits with any kind of threads") {
    const UpsamplerShape s{8, 8, 1};
    const Upsampler<float> u = Upsampler<float>::init(s, Random{1, 0});
    const Image<float> in = random_image<float>(90, 70, 8, 1);
    const Columns<float> g = random_columns<float>(3, 4 * in.size(), 2);
    const auto run = [&]<class B>(B) {
        UpsamplerTrace<float> trace;
        upsampler_forward(B{}, u, in, &trace);
        std::pair<Upsampler<float>, Columns<float>> r{Upsampler<float>(s), {}};
        upsampler_vjp(B{}, u, in, trace, g, r.first, &r.second);
        return r;
    };
    const auto a = run(XsimdBackend<DefaultArch, Serial>{});
    const auto b = run(XsimdBackend<DefaultArch, DefaultThreads>{});
    CHECK(a.second == b.second);
    for (std::size_t l = 0; l < 4; ++l) CHECK(a.first.conv[l] == b.first.conv[l]);
}

TEST_CASE("upsampler: a bad shape is refused") {
    CHECK_THROWS_AS(Upsampler<float>(shape(2, 4, 1, Normalization::none, true)), Error);
    CHECK_THROWS_AS(Upsampler<float>(shape(3, 0, 1, Normalization::none, false)), Error);
}
