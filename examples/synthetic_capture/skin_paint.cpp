// SPDX-License-Identifier: Apache-2.0
#include "synthetic_capture/skin_paint.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include <rye/core/parallel.hpp>

#include "data/threads.hpp"
#include "synthetic_capture/noise.hpp"

namespace rye::trainer {
namespace {

using V3 = Vec3<double>;
using V2 = Vec2<double>;

V3 mix(const V3& a, const V3& b, double t) { return a + (b - a) * t; }

double bell(const V3& p, const V3& centre, double radius) {
    return std::exp(-(p - centre).squaredNorm() / (radius * radius));
}

/// Distance to a polyline in the plane of the face, and the position [0, 1] of the closest point
/// along it.
struct Along {
    double distance = 1e9, side = 0, at = 0;
};
template <std::size_t n>
Along along(const V2& p, const std::array<V2, n>& line) {
    Along best;
    for (std::size_t i = 0; i + 1 < n; ++i) {
        const V2 d = line[i + 1] - line[i], q = p - line[i];
        const double t = std::clamp(q.dot(d) / d.squaredNorm(), 0.0, 1.0);
        const V2 away = q - t * d;
        if (away.norm() < best.distance)
            best = {away.norm(), away.y(),
                    (static_cast<double>(i) + t) / static_cast<double>(n - 1)};
    }
    return best;
}

/// Signed distance to a polygon in the plane of the face, negative inside.
double inside(const V2& p, const V2* corner, int n) {
    double distance = 1e9;
    bool within = false;
    for (int i = 0, j = n - 1; i < n; j = i++) {
        const V2 &a = corner[i], &b = corner[j];
        const V2 d = b - a, q = p - a;
        distance =
            std::min(distance, (q - std::clamp(q.dot(d) / d.squaredNorm(), 0.0, 1.0) * d).norm());
        if ((a.y() > p.y()) != (b.y() > p.y()) && p.x() < d.x() * (p.y() - a.y()) / d.y() + a.x())
            within = !within;
    }
    return within ? -distance : distance;
}

} // namespace

Palette palette(std::uint64_t seed) {
    const Random r{seed, 71};
    // Skin tones from light to dark, along the line of measured ones.
    const double tone = r.uniform(0) * r.uniform(1);
    Palette p;
    p.skin = mix(V3(0.70, 0.395, 0.275), V3(0.26, 0.125, 0.072), tone);
    p.skin *= 0.96 + 0.08 * r.uniform(2);
    p.lips = mix(V3(0.52, 0.185, 0.160), V3(0.21, 0.075, 0.062), tone);
    constexpr std::array hairs{std::array{0.030, 0.020, 0.014}, std::array{0.075, 0.042, 0.024},
                               std::array{0.017, 0.013, 0.011}, std::array{0.155, 0.092, 0.045}};
    const auto& h = hairs[static_cast<std::size_t>(r.below(3, tone > 0.4 ? 3 : 4))];
    p.hair = V3(h[0], h[1], h[2]);
    p.brow = 0.75 * p.hair;
    constexpr std::array irises{std::array{0.10, 0.17, 0.24}, std::array{0.12, 0.17, 0.08},
                                std::array{0.16, 0.085, 0.035}, std::array{0.075, 0.040, 0.020}};
    const auto& i =
        irises[static_cast<std::size_t>(tone > 0.3 ? 2 + r.below(4, 2) : r.below(4, 4))];
    p.eyes.iris = V3(i[0], i[1], i[2]);
    p.eyes.ring = mix(p.eyes.iris, V3(0.22, 0.13, 0.05), 0.6);
    p.eyes.seed = mix64(seed);
    p.freckles = tone < 0.25 ? r.uniform(5) : 0.1;
    p.brow_width = 0.8 + 0.5 * r.uniform(6);
    return p;
}

double hair_cover(const V3& p, double softness) {
    // Height of the hairline at longitudes from the middle of the face [deg].
    static constexpr std::array lines{
        std::array{0.0, 1.07},   std::array{22.0, 1.06},  std::array{38.0, 0.95},
        std::array{47.0, 0.78},  std::array{54.0, 0.50},  std::array{60.0, 0.20},
        std::array{67.0, 0.12},  std::array{74.0, 0.16},  std::array{80.0, 0.36},
        std::array{100.0, 0.36}, std::array{112.0, 0.02}, std::array{130.0, -0.34},
        std::array{181.0, -0.42}};
    const double a = std::atan2(std::abs(p.x()), p.z() - 0.05) * 180 / std::numbers::pi;
    std::size_t i = 0;
    while (i + 2 < lines.size() && a > lines[i + 1][0]) ++i;
    const double t = (a - lines[i][0]) / (lines[i + 1][0] - lines[i][0]);
    const double line = lines[i][1] + (lines[i + 1][1] - lines[i][1]) * smooth_step(0, 1, t);
    return smooth_step(-softness, softness, p.y() - line);
}

SkinPaint::SkinPaint(const std::array<V3, 68>& landmarks, const Palette& colours,
                     std::uint64_t seed)
    : landmarks_(landmarks),
      palette_(colours),
      seed_(mix64(seed ^ 0x5EEDULL)) {
    const Random r{seed_, 5};
    moles_.resize(3, 9);
    for (Index i = 0; i < moles_.cols(); ++i) {
        const auto k = static_cast<std::uint64_t>(4 * i);
        const V3& base = landmarks_[static_cast<std::size_t>(r.below(k, 17))];
        const V3& nose = landmarks_[30];
        const V3 mole =
            mix(base, nose, 0.15 + 0.5 * r.uniform(k + 1)) + V3(0, 0.5 * r.uniform(k + 2) - 0.1, 0);
        moles_.col(i) = mole;
    }
}

Vec4<double> SkinPaint::operator()(const V3& p) const {
    const V2 xy(p.x(), p.y());
    const double front = smooth_step(0.25, 0.5, p.z());
    const auto flat = [&](int i) { return V2(landmarks_[static_cast<std::size_t>(i)].head<2>()); };

    // Skin: blotches, pores, blood below thin places, freckles, moles.
    V3 colour =
        palette_.skin * (1 + 0.16 * fractal(seed_, 3.5 * p, 4) + 0.09 * noise(seed_ + 9, 42 * p));
    double gloss = 0.35 + 0.2 * noise(seed_ + 10, 18 * p);
    const V3 &nose = landmarks_[30], &chin = landmarks_[8];
    double red = 0.22 * noise(seed_ + 11, 7 * p) + 0.16 * noise(seed_ + 12, 22 * p);
    for (const double s : {-1.0, 1.0}) {
        red += 0.75 * bell(p, V3(0.44 * s, 0.03, 0.85), 0.22);
        red += 0.55 * bell(p, V3(0.80 * s, 0.12, 0.05), 0.28);
    }
    red += 0.65 * bell(p, nose, 0.15) + 0.25 * bell(p, chin, 0.2);
    const V3 blood(1.06, 0.72, 0.68);
    colour = colour.cwiseProduct(mix(V3::Ones(), blood, std::clamp(red, -0.3, 1.2)));
    const double freckled = front * palette_.freckles *
                            (bell(p, V3(0, 0.12, 1.15), 0.30) + bell(p, V3(0.38, 0.08, 0.9), 0.30) +
                             bell(p, V3(-0.38, 0.08, 0.9), 0.30) + 0.15);
    if (freckled > 0.02) {
        const double freckle = 0.55 * spots(seed_ + 20, 22 * p, 0.30, 0.22) +
                               0.35 * spots(seed_ + 21, 37 * p, 0.30, 0.26);
        colour = colour.cwiseProduct(
            mix(V3::Ones(), V3(0.60, 0.42, 0.32), std::min(1.0, freckled * freckle)));
    }
    for (Index i = 0; i < moles_.cols(); ++i) {
        const double d = (p - V3(moles_.col(i))).norm();
        colour = mix(colour, 0.18 * palette_.skin, 0.85 * smooth_step(0.021, 0.009, d));
    }

    // Around the eyes: thinner, darker skin; lashes along the lids.
    for (const int first : {36, 42}) {
        std::array<V2, 6> eye;
        for (int i = 0; i < 6; ++i) eye[static_cast<std::size_t>(i)] = flat(first + i);
        const double d = front > 0 ? inside(xy, eye.data(), 6) : 1.0;
        colour = colour.cwiseProduct(
            mix(V3::Ones(), V3(0.80, 0.66, 0.64), front * smooth_step(0.16, 0.02, d)));
        const bool upper = along(xy, std::array{eye[0], eye[1], eye[2], eye[3]}).side > 0;
        const double lash = smooth_step(upper ? 0.026 : 0.014, upper ? 0.006 : 0.0, d);
        colour = mix(colour, 0.5 * palette_.brow, front * lash * (upper ? 0.9 : 0.45));
    }

    // Brows: short strokes that lie down towards the temples.
    for (const int s : {-1, 1}) {
        std::array<V2, 5> arch; // from the nose outwards
        for (int i = 0; i < 5; ++i)
            arch[static_cast<std::size_t>(i)] = flat(s > 0 ? 22 + i : 21 - i);
        if (front <= 0) break;
        const Along a = along(xy, arch);
        if (a.distance > 0.2) continue;
        const V2 across(p.x() * s, p.y() - landmarks_[19].y());
        const V3 strand(26 * (across.x() * 0.75 + across.y() * 0.66),
                        110 * (across.y() * 0.75 - across.x() * 0.55), 3.0 * p.z());
        const double thick = palette_.brow_width * (0.052 - 0.034 * a.at * a.at) *
                             (1 + 0.55 * noise(seed_ + 30, strand));
        const double cover = smooth_step(1.15, 0.55, a.distance / thick) *
                             (0.80 + 0.40 * noise(seed_ + 31, 1.3 * strand));
        const bool beyond = a.at <= 0 || a.at >= 1;
        colour =
            mix(colour, palette_.brow, front * std::clamp(cover * (beyond ? 0.9 : 1.0), 0.0, 0.93));
        gloss *= 1 - 0.5 * std::clamp(cover, 0.0, 1.0);
    }

    // Lips, with fine upright lines, and the shadow between them.
    if (p.z() > 0.6) {
        std::array<V2, 12> mouth;
        for (int i = 0; i < 12; ++i) mouth[static_cast<std::size_t>(i)] = flat(48 + i);
        const double d = inside(xy, mouth.data(), 12) - 0.012;
        if (d < 0.03) {
            const double lip = smooth_step(0.014, -0.012, d + 0.006 * noise(seed_ + 40, 25 * p));
            const double line = noise(seed_ + 41, V3(55 * p.x(), 9 * p.y(), 9 * p.z()));
            colour = mix(colour, palette_.lips * (1 + 0.22 * line), 0.92 * lip);
            gloss = std::lerp(gloss, 0.85, lip);
        }
        std::array<V2, 5> seam{flat(48), flat(61), flat(62), flat(63), flat(54)};
        const double seam_distance = along(xy, seam).distance;
        colour *= 1 - 0.45 * smooth_step(0.022, 0.004, seam_distance);
    }

    // Nostrils.
    for (const double s : {-1.0, 1.0}) {
        const V3 at(0.052 * s, landmarks_[33].y() + 0.022, landmarks_[33].z() - 0.005);
        const V3 q = (p - at).cwiseQuotient(V3(0.030, 0.024, 0.055));
        colour *= 1 - 0.8 * smooth_step(1.15, 0.6, q.norm());
    }

    // Hair, cut short: strands run down from the crown.
    double hair = hair_cover(p + V3(0, 0.1, 0), 0.035);
    if (hair > 0) {
        const double edge = 0.05 * noise(seed_ + 50, 9 * p) +
                            0.05 * noise(seed_ + 51, V3(40 * p.x(), 4 * p.y(), 40 * p.z()));
        hair = hair_cover(p + V3(0, edge, 0), 0.035);
    }
    if (hair > 0) {
        const double turn = std::atan2(p.x(), p.z() + 0.15);
        const double strands = noise(seed_ + 52, V3(46 * turn, 5 * p.y(), 6 * p.z())) +
                               0.7 * noise(seed_ + 53, V3(95 * turn, 8 * p.y(), 10 * p.z()));
        const double tufts = fractal(seed_ + 54, 7 * p, 3);
        const V3 strand = palette_.hair * std::max(0.35, 1 + 0.75 * strands + 0.35 * tufts);
        colour = mix(colour, strand, 0.97 * hair);
        gloss = std::lerp(gloss, 0.30 + 0.3 * strands, hair);
    }
    constexpr double least = 0.004; // no texel is fully black
    return {std::max(colour[0], least), std::max(colour[1], least), std::max(colour[2], least),
            std::clamp(gloss, 0.0, 1.0)};
}

Image<float> painted(const HeadModel& model, const Points& neutral, const SkinPaint& paint,
                     int width, int height) {
    const Index n = static_cast<Index>(width) * height;
    // Position of each texel on the neutral head, by rasterising faces in texture space.
    Points rest = Points::Zero(3, n);
    std::vector<char> known(static_cast<std::size_t>(n), 0);
    for (std::size_t f = 0; f < model.faces.size(); ++f) {
        if (model.parts[f] != Part::skin) continue;
        std::array<V2, 3> c;
        for (std::size_t k = 0; k < 3; ++k) {
            const Index u = model.face_uv[f][k];
            c[k] = V2(model.uv(0, u) * width, model.uv(1, u) * height);
        }
        const V2 ab = c[1] - c[0], ac = c[2] - c[0];
        const double area = ab.x() * ac.y() - ab.y() * ac.x();
        if (area == 0) continue;
        const auto low = [&](int d) { return std::min({c[0][d], c[1][d], c[2][d]}); };
        const auto high = [&](int d) { return std::max({c[0][d], c[1][d], c[2][d]}); };
        const int y1 = std::min(height - 1, static_cast<int>(high(1)));
        const int x1 = std::min(width - 1, static_cast<int>(high(0)));
        for (int y = std::max(0, static_cast<int>(low(1))); y <= y1; ++y)
            for (int x = std::max(0, static_cast<int>(low(0))); x <= x1; ++x) {
                const V2 q = V2(x + 0.5, y + 0.5) - c[0];
                const double u = (q.x() * ac.y() - q.y() * ac.x()) / area;
                const double v = (ab.x() * q.y() - ab.y() * q.x()) / area;
                if (u < -1e-9 || v < -1e-9 || u + v > 1 + 1e-9) continue;
                const Index at = static_cast<Index>(y) * width + x;
                const Face& i = model.faces[f];
                const V3 p =
                    (1 - u - v) * neutral.col(i[0]) + u * neutral.col(i[1]) + v * neutral.col(i[2]);
                rest.col(at) = p;
                known[static_cast<std::size_t>(at)] = 1;
            }
    }
    Image<float> image(width, height, 4);
    for_chunks(program_threads(), n, 4096, [&](Index begin, Index end, Index) {
        for (Index i = begin; i < end; ++i)
            if (known[static_cast<std::size_t>(i)]) {
                const Vec4<float> texel = paint(rest.col(i)).cast<float>();
                std::copy_n(texel.data(), 4, image.pixels.data() + 4 * i);
            }
    });
    // Dilated, so that bilinear look-ups at seams read no empty texel.
    for (int round = 0; round < 3; ++round) {
        const std::vector<char> before = known;
        const Columns<float> old = image.pixels;
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x) {
                const Index at = static_cast<Index>(y) * width + x;
                if (before[static_cast<std::size_t>(at)]) continue;
                for (const auto& [dx, dy] : {std::pair{-1, 0}, {1, 0}, {0, -1}, {0, 1}}) {
                    const int k = x + dx, l = y + dy;
                    const Index from = static_cast<Index>(l) * width + k;
                    if (k < 0 || l < 0 || k >= width || l >= height ||
                        !before[static_cast<std::size_t>(from)])
                        continue;
                    std::copy_n(old.data() + 4 * from, 4, image.pixels.data() + 4 * at);
                    known[static_cast<std::size_t>(at)] = 1;
                    break;
                }
            }
    }
    return image;
}

} // namespace rye::trainer
