// SPDX-License-Identifier: Apache-2.0
#include "corrections/skin_pictures.hpp"

#include <algorithm>
#include <array>

#include "data/threads.hpp"

namespace rye::trainer {
namespace {

/// Blurs by (1, 4, 6, 4, 1) / 16 in x and y; negative values stay, and spread to what they touch.
void blur(std::vector<float>& grey, int width, int height) {
    constexpr std::array<float, 5> weights{1, 4, 6, 4, 1};
    for (const bool along_x : {true, false}) {
        std::vector<float> out(grey.size(), -1.0F);
        for (int y = 2; y + 2 < height; ++y)
            for (int x = 2; x + 2 < width; ++x) {
                float sum = 0;
                bool inside = true;
                for (int k = -2; k <= 2; ++k) {
                    const int at = along_x ? y * width + x + k : (y + k) * width + x;
                    const float v = grey[static_cast<std::size_t>(at)];
                    inside = inside && v >= 0;
                    sum += weights[static_cast<std::size_t>(k + 2)] * v;
                }
                if (inside) out[static_cast<std::size_t>(y * width + x)] = sum / 16;
            }
        grey = std::move(out);
    }
}

} // namespace

SkinPictures::SkinPictures(const Capture& capture, const std::vector<int>& frames,
                           const std::vector<std::size_t>& cameras, int largest)
    : cameras_(cameras.size()) {
    const int smaller = (std::max(capture.width, capture.height) + largest - 1) / largest;
    scale_ = 1.0 / smaller;
    pictures_.resize(frames.size() * cameras.size());
    program_threads().run(static_cast<Index>(pictures_.size()), [&](Index i) {
        const auto k = static_cast<std::size_t>(i);
        const int frame = frames[k / cameras.size()];
        const auto camera = static_cast<int>(cameras[k % cameras.size()]);
        if (!capture.view(frame, camera).present) return;
        const Image<float> rgb = capture.image(frame, camera), mask = capture.mask(frame, camera);
        Picture& p = pictures_[k];
        p.width = rgb.width / smaller;
        p.height = rgb.height / smaller;
        p.grey.assign(static_cast<std::size_t>(p.width * p.height), 0);
        for (int y = 0; y < p.height; ++y)
            for (int x = 0; x < p.width; ++x) {
                float sum = 0;
                bool inside = true;
                for (int b = 0; b < smaller; ++b)
                    for (int a = 0; a < smaller; ++a) {
                        const int u = x * smaller + a, v = y * smaller + b;
                        inside = inside && mask.at(u, v)[0] >= 0.98F;
                        sum += rgb.at(u, v).head(3).mean();
                    }
                p.grey[static_cast<std::size_t>(y * p.width + x)] =
                    inside ? sum / static_cast<float>(smaller * smaller) : -1.0F;
            }
        blur(p.grey, p.width, p.height);
    });
}

SkinPictures SkinPictures::coarser(int side) const {
    int largest = 0;
    for (const Picture& p : pictures_) largest = std::max({largest, p.width, p.height});
    const int block = std::max(1, (largest + side / 2) / side);
    if (block == 1) return *this;
    SkinPictures out(cameras_, scale_ / block);
    out.pictures_.resize(pictures_.size());
    program_threads().run(static_cast<Index>(pictures_.size()), [&](Index i) {
        const Picture& from = pictures_[static_cast<std::size_t>(i)];
        Picture& p = out.pictures_[static_cast<std::size_t>(i)];
        p.width = from.width / block;
        p.height = from.height / block;
        p.grey.assign(from.grey.empty() ? 0 : static_cast<std::size_t>(p.width * p.height), -1.0F);
        if (from.grey.empty()) return;
        for (int y = 0; y < p.height; ++y)
            for (int x = 0; x < p.width; ++x) {
                float sum = 0;
                bool inside = true;
                for (int b = 0; b < block; ++b)
                    for (int a = 0; a < block; ++a) {
                        const int at = (y * block + b) * from.width + x * block + a;
                        const float v = from.grey[static_cast<std::size_t>(at)];
                        inside = inside && v >= 0;
                        sum += v;
                    }
                if (inside)
                    p.grey[static_cast<std::size_t>(y * p.width + x)] =
                        sum / static_cast<float>(block * block);
            }
        blur(p.grey, p.width, p.height);
    });
    return out;
}

std::optional<SkinValue> SkinPictures::value(std::size_t frame, std::size_t camera,
                                             const Vec2<double>& at) const {
    const Picture& p = pictures_[frame * cameras_ + camera];
    const double u = at.x() * scale_ - 0.5, v = at.y() * scale_ - 0.5;
    if (p.grey.empty() || !(u >= 1 && v >= 1 && u < p.width - 2 && v < p.height - 2))
        return std::nullopt;
    const int x0 = static_cast<int>(u), y0 = static_cast<int>(v);
    const double s = u - x0, t = v - y0;
    std::array<std::array<double, 4>, 4> g{}; // g[y][x] around it
    for (std::size_t b = 0; b < 4; ++b)
        for (std::size_t a = 0; a < 4; ++a) {
            const int w = (y0 - 1 + static_cast<int>(b)) * p.width + x0 - 1 + static_cast<int>(a);
            g[b][a] = static_cast<double>(p.grey[static_cast<std::size_t>(w)]);
            if (!(g[b][a] >= 0)) return std::nullopt;
        }
    const auto value = [&](std::size_t b, std::size_t a) {
        return (1 - t) * ((1 - s) * g[b][a] + s * g[b][a + 1]) +
               t * ((1 - s) * g[b + 1][a] + s * g[b + 1][a + 1]);
    };
    const Vec2<double> slope(value(1, 2) - value(1, 0), value(2, 1) - value(0, 1));
    return SkinValue{at, slope / 2 * scale_, value(1, 1)};
}

} // namespace rye::trainer
