// SPDX-License-Identifier: Apache-2.0
#include "data/flaw_pictures.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include <rye/math/srgb.hpp>

namespace rye::trainer {
namespace {

std::uint8_t rounded(double x) {
    return static_cast<std::uint8_t>(std::lround(std::clamp(x, 0.0, 255.0)));
}

/// Returns an image blurred along one axis: each column is a mean of the columns around it, without
/// weights beyond the image.
Image<float> blurred_along(const Image<float>& in, const std::vector<float>& weights,
                           bool along_x) {
    Image<float> out(in.width, in.height, in.channels());
    const int reach = static_cast<int>(weights.size()) - 1, end = along_x ? in.width : in.height;
    for (int y = 0; y < in.height; ++y)
        for (int x = 0; x < in.width; ++x) {
            const int at = along_x ? x : y;
            float total = 0;
            for (int k = std::max(0, at - reach); k <= std::min(end - 1, at + reach); ++k) {
                const float w = weights[static_cast<std::size_t>(std::abs(k - at))];
                out.at(x, y) += w * (along_x ? in.at(k, y) : in.at(x, k));
                total += w;
            }
            out.at(x, y) /= total;
        }
    return out;
}

/// Returns an image blurred by a normal kernel of a standard deviation [px].
Image<float> blurred(const Image<float>& in, double size) {
    std::vector<float> weights;
    const int reach = static_cast<int>(std::ceil(4 * size));
    for (int i = 0; i <= reach; ++i)
        weights.push_back(static_cast<float>(std::exp(-0.5 * i * i / (size * size))));
    return blurred_along(blurred_along(in, weights, true), weights, false);
}

/// Returns the coverage of pixel i, 1 without a mask.
double coverage(const Image8* mask, Index i) {
    return mask == nullptr ? 1 : mask->values[static_cast<std::size_t>(i)] / 255.0;
}

/// Returns the stored values [of 255] of a picture over black, from linear light before it was cut
/// out.
Vec3<double> stored(const Vec3<double>& light, double alpha) {
    Vec3<double> v;
    for (const int c : {0, 1, 2})
        v[c] = 255 * alpha * std::min(1.0, srgb_from_linear(std::max(0.0, light[c])));
    return v;
}

/// Blurs light within the mask; pixels outside do not contribute.
void blur_light(Image<float>& light, const Image<float>& values, const Image8* mask, double size,
                FlawSum& sum) {
    Image<float> weighted(light.width, light.height, 4);
    for (Index i = 0; i < light.size(); ++i) {
        const auto alpha = static_cast<float>(coverage(mask, i));
        weighted.pixels.col(i) << alpha * light.pixels.col(i), alpha;
    }
    weighted = blurred(weighted, size);
    for (Index i = 0; i < light.size(); ++i) {
        const double alpha = coverage(mask, i);
        if (alpha == 0) continue;
        light.pixels.col(i) = weighted.pixels.col(i).head<3>() / weighted.pixels(3, i);
        const Vec3<double> now = stored(light.pixels.col(i).cast<double>(), alpha);
        for (const int c : {0, 1, 2}) sum.add(now[c] - values.pixels(c, i));
    }
}

/// Applies blur, falloff and gains to stored values [of 255].
void flaw_light(Image<float>& values, const Image8* mask, const LightFlaws& flaws, FlawSums& sums) {
    Image<float> light(values.width, values.height, 3);
    for (Index i = 0; i < light.size(); ++i) {
        const double alpha = coverage(mask, i);
        for (const int c : {0, 1, 2})
            if (alpha > 0)
                light.pixels(c, i) =
                    static_cast<float>(linear_from_srgb(values.pixels(c, i) / (255 * alpha)));
    }
    if (flaws.blur > 0) blur_light(light, values, mask, flaws.blur, sums[Flaw::blur]);
    const double cx = values.width / 2.0, cy = values.height / 2.0;
    for (int y = 0; y < values.height; ++y)
        for (int x = 0; x < values.width; ++x) {
            const Index i = static_cast<Index>(y) * values.width + x;
            const double alpha = coverage(mask, i);
            if (alpha == 0) continue;
            const double dx = x + 0.5 - cx, dy = y + 0.5 - cy;
            const double away = (dx * dx + dy * dy) / (cx * cx + cy * cy); // 1 in the corners
            const Vec3<double> now = std::exp(-flaws.falloff * away) *
                                     flaws.gains.cwiseProduct(light.pixels.col(i).cast<double>());
            values.pixels.col(i) = stored(now, alpha).cast<float>();
        }
}

/// Returns the weights of a cubic B-spline on four points, the second of which is `t` below.
std::array<double, 4> spline_weights(double t) {
    const double u = 1 - t;
    return {u * u * u / 6, (3 * t * t * t - 6 * t * t + 4) / 6, (3 * u * u * u - 6 * u * u + 4) / 6,
            t * t * t / 6};
}

/// Smooth field of standard normal numbers over an image, alike over `spacing` pixels.
class SmoothField {
  public:
    SmoothField(const Random& random, int width, int height, double spacing)
        : spacing_(spacing),
          columns_(static_cast<std::size_t>(width / spacing) + 4) {
        const std::size_t rows = static_cast<std::size_t>(height / spacing) + 4;
        for (std::size_t i = 0; i < columns_ * rows; ++i) points_.push_back(random.normal(i));
    }
    double at(int x, int y) const {
        const double gx = x / spacing_, gy = y / spacing_;
        const auto ix = static_cast<std::size_t>(gx), iy = static_cast<std::size_t>(gy);
        const auto wx = spline_weights(gx - std::floor(gx));
        const auto wy = spline_weights(gy - std::floor(gy));
        double sum = 0, squares = 0;
        for (std::size_t j = 0; j < 4; ++j)
            for (std::size_t i = 0; i < 4; ++i) {
                const double w = wx[i] * wy[j];
                sum += w * points_[(iy + j) * columns_ + ix + i];
                squares += w * w;
            }
        return sum / std::sqrt(squares);
    }

  private:
    double spacing_; // [px]
    std::size_t columns_;
    std::vector<double> points_; // row by row
};

/// Returns the value of one channel between pixels; beyond the border, the border's.
double between(const Image8& image, double x, double y) {
    const auto value = [&](int u, int v) {
        u = std::clamp(u, 0, image.width - 1);
        v = std::clamp(v, 0, image.height - 1);
        return static_cast<double>(
            image.values[static_cast<std::size_t>(v) * static_cast<std::size_t>(image.width) +
                         static_cast<std::size_t>(u)]);
    };
    const int u = static_cast<int>(std::floor(x)), v = static_cast<int>(std::floor(y));
    return std::lerp(std::lerp(value(u, v), value(u + 1, v), x - u),
                     std::lerp(value(u, v + 1), value(u + 1, v + 1), x - u), y - v);
}

} // namespace

LightFlaws light_flaws(const FlawDraws& draws, const FlawSizes& sizes, std::size_t camera,
                       FlawSums& sums) {
    LightFlaws flaws;
    const auto percent = [&](Flaw flaw, std::uint64_t index) {
        return sizes[flaw] > 0 ? drawn(draws.of(flaw, camera), index, sizes[flaw], sums[flaw]) / 100
                               : 0;
    };
    const double gain = percent(Flaw::gain, 0);
    for (const int c : {0, 1, 2})
        flaws.gains[c] =
            std::exp(gain + percent(Flaw::white_balance, static_cast<std::uint64_t>(c)));
    flaws.falloff = std::abs(percent(Flaw::vignetting, 0));
    flaws.blur = sizes[Flaw::blur];
    flaws.noise = sizes[Flaw::noise];
    return flaws;
}

Image8 flawed_picture(const FlawedPicture& p, const LightFlaws& flaws, const Random& noise,
                      FlawSums& sums) {
    const Image8& in = *p.picture;
    Image<float> values(in.width, in.height, in.channels);
    for (std::size_t i = 0; i < in.values.size(); ++i)
        values.pixels.data()[i] = static_cast<float>(in.values[i]);
    if (flaws.blur > 0 || flaws.falloff > 0 || flaws.gains != Vec3<double>::Ones())
        flaw_light(values, p.mask, flaws, sums);
    Image8 out{in.width, in.height, in.channels, {}};
    for (Index i = 0; i < values.size(); ++i) {
        const double alpha = coverage(p.mask, i);
        const double kept =
            p.cut == nullptr || alpha == 0 ? 1 : std::min(1.0, coverage(p.cut, i) / alpha);
        for (int c = 0; c < in.channels; ++c) {
            double v = values.pixels(c, i);
            if (flaws.noise > 0 && alpha > 0)
                v += alpha * drawn(noise, static_cast<std::uint64_t>(in.channels * i + c),
                                   flaws.noise, sums[Flaw::noise]);
            out.values.push_back(rounded(kept * v));
        }
    }
    return out;
}

Image8 softened(const Image8& mask, double size, FlawSums& sums) {
    const Image<float> soft = blurred(to_float(mask), size);
    Image8 out{mask.width, mask.height, 1, {}};
    for (Index i = 0; i < soft.size(); ++i) {
        out.values.push_back(rounded(255.0 * soft.pixels(0, i)));
        sums[Flaw::soft_masks].add(out.values.back() -
                                   double(mask.values[static_cast<std::size_t>(i)]));
    }
    return out;
}

Image8 displaced(const Image8& mask, double size, const Random& random, FlawSums& sums) {
    const double spacing = 4 * size + 4;
    const SmoothField sideways(random.fork(0), mask.width, mask.height, spacing);
    const SmoothField upward(random.fork(1), mask.width, mask.height, spacing);
    Image8 out{mask.width, mask.height, 1, {}};
    for (int y = 0; y < mask.height; ++y)
        for (int x = 0; x < mask.width; ++x) {
            const double dx = size * sideways.at(x, y);
            const double dy = size * upward.at(x, y);
            sums[Flaw::wrong_masks].add(dx);
            sums[Flaw::wrong_masks].add(dy);
            out.values.push_back(rounded(between(mask, x + dx, y + dy)));
        }
    return out;
}

Image8 dilated(const Image8& eyes, double distance, FlawSums& sums) {
    Image8 out = eyes;
    std::vector<int> nearest(eyes.values.size(), std::numeric_limits<int>::max()); // squared [px^2]
    const int reach = static_cast<int>(distance);
    const auto at = [&](int x, int y) {
        return static_cast<std::size_t>(y) * static_cast<std::size_t>(eyes.width) +
               static_cast<std::size_t>(x);
    };
    for (int y = 0; y < eyes.height; ++y)
        for (int x = 0; x < eyes.width; ++x) {
            const std::uint8_t label = eyes.values[at(x, y)];
            if (label == 0) continue;
            for (int v = std::max(0, y - reach); v <= std::min(eyes.height - 1, y + reach); ++v)
                for (int u = std::max(0, x - reach); u <= std::min(eyes.width - 1, x + reach);
                     ++u) {
                    const int away = (u - x) * (u - x) + (v - y) * (v - y);
                    if (eyes.values[at(u, v)] != 0 || away > distance * distance ||
                        away >= nearest[at(u, v)])
                        continue;
                    if (out.values[at(u, v)] == 0) ++sums[Flaw::eye_mask_dilation].count;
                    nearest[at(u, v)] = away;
                    out.values[at(u, v)] = label;
                }
        }
    return out;
}

} // namespace rye::trainer
