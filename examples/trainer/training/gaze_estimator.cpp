// SPDX-License-Identifier: Apache-2.0
#include "training/gaze_estimator.hpp"

#include <array>
#include <cmath>
#include <vector>

#include <rye/rig/gaze.hpp>

namespace rye::trainer {
namespace {

struct Seen {
    Vec3<double> direction;  ///< unit, from the eyeball's centre, head frame
    double brightness;
};

/// f(x, y, pixel) for each usable pixel of an eye.
template <class F>
void for_usable(const Columns<float>& eye, int width, const F& f) {
    const int height = static_cast<int>(eye.cols()) / width;
    for (int y = 1; y < height; ++y)
        for (int x = 1; x + 1 < width; ++x) {
            const Index p = static_cast<Index>(y) * width + x;
            const auto inside = [&](Index q) { return eye(0, q) >= 0.5f; };
            if (inside(p) && inside(p - 1) && inside(p + 1) && inside(p - width)) f(x, y, p);
        }
}

/// Where the ray of each usable pixel meets the sphere.
std::vector<Seen> seen_directions(const Image<float>& image, const Columns<float>& eye,
                                  const Pinhole<double>& camera, const EyeballGeometry& ball) {
    std::vector<Seen> all;
    const Vec3<double> from = camera.centre();
    for_usable(eye, image.width, [&](int x, int y, Index p) {
        const Vec3<double> ray = camera.ray(Vec2<double>(x + 0.5, y + 0.5));
        // Closest approach, then half a chord back (no cancelling discriminant); a ray that
        // passes just outside, at the rim, takes the closest point itself.
        const Vec3<double> to = ball.centre - from;
        const double along = to.dot(ray);
        const Vec3<double> miss = from + along * ray - ball.centre;
        const double half2 = ball.radius * ball.radius - miss.squaredNorm();
        const Vec3<double> hit = miss - std::sqrt(std::max(half2, 0.0)) * ray;
        // The iris reflects its own colour, the sclera all; red tells them apart best.
        const Vec3<double> rgb = image.pixels.col(p).head(3).cast<double>();
        all.push_back({ball.head_rotation.transpose() * hit.normalized(),
                       0.5 * rgb.x() + 0.35 * rgb.y() + 0.15 * rgb.z()});
    });
    return all;
}

/// Share of the variance of brightness that the rings around g explain; 0 if the iris is not darker
/// by min_darkening.
/// Memberships are soft over the width of a pixel so that the score is smooth in g.
double explained(const std::vector<Seen>& seen, const Vec3<double>& g, double limbus, double soft) {
    std::array<double, 3> n{}, sum{};
    double all = 0, all2 = 0;
    for (const Seen& s : seen) {
        const double angle = std::acos(std::clamp(s.direction.dot(g), -1.0, 1.0));
        const double iris = std::clamp(0.5 + (limbus - angle) / soft, 0.0, 1.0);
        const double pupil = std::clamp(0.5 + (0.35 * limbus - angle) / soft, 0.0, 1.0);
        const std::array<double, 3> w{pupil, iris * (1 - pupil), 1 - iris};
        for (std::size_t k = 0; k < 3; ++k) {
            n[k] += w[k];
            sum[k] += w[k] * s.brightness;
        }
        all += s.brightness;
        all2 += s.brightness * s.brightness;
    }
    const double count = static_cast<double>(seen.size());
    const double mean = all / count, variance = all2 / count - mean * mean;
    if (variance < 1e-8 || n[2] < 1 || n[1] + n[0] < 1) return 0;
    const double sclera = sum[2] / n[2], dark = (sum[1] + sum[0]) / (n[1] + n[0]);
    if (dark > (1 - min_darkening) * sclera) return 0;
    double between = 0;
    for (std::size_t k = 0; k < 3; ++k)
        if (n[k] > 0.5) between += n[k] * (sum[k] / n[k] - mean) * (sum[k] / n[k] - mean);
    return between / (count * variance);
}

} // namespace

int usable_eye_pixels(const Columns<float>& eye, int width) {
    int count = 0;
    for_usable(eye, width, [&](int, int, Index) { ++count; });
    return count;
}

std::optional<GazeEstimate> estimate_gaze(const Image<float>& image, const Columns<float>& eye,
                                          const Pinhole<double>& camera,
                                          const EyeballGeometry& eyeball) {
    const std::vector<Seen> seen = seen_directions(image, eye, camera, eyeball);
    if (static_cast<int>(seen.size()) < min_eye_pixels) return std::nullopt;
    const double limbus = std::asin(std::min(0.9, eyeball.limbus_radius / eyeball.radius));
    const double depth = (eyeball.centre - camera.centre()).norm();
    const double soft = depth / camera.fx / eyeball.radius;  // a pixel on the eyeball [rad]

    constexpr double degree = 3.14159265358979323846 / 180;
    double best = 0, pitch = 0, yaw = 0;
    double step = 4 * degree, reach = 52 * degree;
    for (int level = 0; level < 6; ++level) {  // 4 degrees down to 4 / 3^5 = 0.016
        const double p0 = pitch, y0 = yaw;
        const int n = static_cast<int>(std::round(reach / step));
        for (int i = -n; i <= n; ++i)
            for (int j = -n; j <= n; ++j) {
                const double p = p0 + i * step, y = y0 + j * step;
                const double score = explained(seen, gaze_vector(p, y), limbus, soft);
                if (score > best) best = score, pitch = p, yaw = y;
            }
        reach = 2 * step;
        step /= 3;
    }
    if (best < min_contrast) return std::nullopt;
    return GazeEstimate{gaze_vector(pitch, yaw), best, static_cast<int>(seen.size())};
}

} // namespace rye::trainer
