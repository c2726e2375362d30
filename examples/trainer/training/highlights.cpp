// SPDX-License-Identifier: Apache-2.0
#include "training/highlights.hpp"

#include <algorithm>
#include <cmath>

#include "data/median.hpp"

namespace rye::trainer {
namespace {

/// Share of the limbus' radius within which highlights are looked for: beyond it the sclera may
/// show where a gaze's label is off.
constexpr double inner = 0.88;
/// Fewest pixels of the iris that a picture has to show.
constexpr std::size_t least_pixels = 24;
/// A highlight is brighter than the median by this, and by so many deviations.
constexpr double least_contrast = 0.12, deviations = 6;
/// Part of its height above the median down to which pixels belong to a highlight.
constexpr double foot = 0.35;
/// Largest share of the iris' pixels that a highlight covers.
constexpr double largest = 0.3;

/// Pixels of the iris, in a box of the picture.
struct IrisPixels {
    int x0 = 0, y0 = 0, width = 0, height = 0;
    std::vector<float> value; ///< smallest channel; below 0 where the iris is not seen
    std::vector<double> seen; ///< those that are

    float& at(int x, int y) { return value[static_cast<std::size_t>(y * width + x)]; }
    bool shows(int x, int y) const {
        return x >= 0 && y >= 0 && x < width && y < height &&
               value[static_cast<std::size_t>(y * width + x)] >= 0;
    }
};

IrisPixels iris_pixels(const Image<float>& picture, const Columns<float>& area,
                       const CorneaInPicture& of) {
    IrisPixels p;
    const Vec3<double> centre = of.eye.apply(of.cornea.centre);
    const double depth = of.camera.camera_from_world.apply(centre).z();
    if (!(depth > of.camera.near_depth)) return p;
    const Vec2<double> middle = of.camera.project_point(centre).head<2>();
    const double reach = of.camera.fx * of.eye.scale * of.cornea.radius / depth + 1;
    if (!(middle.allFinite() && reach < 1e5)) return p;
    const auto inside = [](double v, int side) {
        return static_cast<int>(std::clamp(v, 0.0, static_cast<double>(side)));
    };
    p.x0 = inside(middle.x() - reach, picture.width);
    p.y0 = inside(middle.y() - reach, picture.height);
    p.width = inside(middle.x() + reach + 1, picture.width) - p.x0;
    p.height = inside(middle.y() + reach + 1, picture.height) - p.y0;
    p.value.assign(static_cast<std::size_t>(std::max(0, p.width) * std::max(0, p.height)), -1);
    for (int y = 0; y < p.height; ++y)
        for (int x = 0; x < p.width; ++x) {
            const Index i = static_cast<Index>(p.y0 + y) * picture.width + p.x0 + x;
            if (!(area(0, i) > 0.5F)) continue;
            if (!of.under({p.x0 + x + 0.5, p.y0 + y + 0.5})) continue;
            p.at(x, y) = std::max(0.0F, picture.pixels.col(i).minCoeff());
            p.seen.push_back(static_cast<double>(p.at(x, y)));
        }
    return p;
}

} // namespace

std::optional<Vec3<double>> CorneaInPicture::under(const Vec2<double>& at) const {
    const Vec3<double> from = into_eye(eye, camera.centre()) - cornea.centre;
    const Vec3<double> far = into_eye(eye, Vec3<double>(camera.centre() + camera.ray(at)));
    const Vec3<double> d = normalized(Vec3<double>(far - cornea.centre - from));
    const double along = -from.dot(d), off = from.squaredNorm() - along * along;
    const double half = cornea.radius * cornea.radius - off;
    if (half < 0) return {};
    const Vec3<double> hit = cornea.centre + from + (along - std::sqrt(half)) * d;
    const double height = hit.dot(cornea.axis);
    const double aside = (hit - height * cornea.axis).norm();
    if (height < cornea.rim || aside > inner * limbus_radius) return {};
    return hit;
}

Vec2<double> CorneaInPicture::shown(const Vec3<double>& at) const {
    return camera.project_point(eye.apply(at)).head<2>();
}

bool shows_cornea(const Columns<float>& area, const CorneaInPicture& of, const Vec2<double>& at) {
    const int x = static_cast<int>(std::floor(at.x())), y = static_cast<int>(std::floor(at.y()));
    for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx) {
            const int u = x + dx, v = y + dy;
            if (u < 0 || v < 0 || u >= of.camera.width || v >= of.camera.height) return false;
            if (!(area(0, static_cast<Index>(v) * of.camera.width + u) > 0.5F)) return false;
            if (!of.under({u + 0.5, v + 0.5})) return false;
        }
    return true;
}

std::vector<Highlight> find_highlights(const Image<float>& picture, const Columns<float>& area,
                                       const CorneaInPicture& of) {
    IrisPixels p = iris_pixels(picture, area, of);
    if (p.seen.size() < least_pixels) return {};
    const double middle = median(p.seen);
    std::vector<double> off;
    for (const double v : p.seen) off.push_back(std::abs(v - middle));
    const double contrast = std::max(least_contrast, deviations * 1.4826 * median(off));
    Vec3<double> around;
    for (Index c = 0; c < 3; ++c) {
        std::vector<double> channel;
        for (int y = 0; y < p.height; ++y)
            for (int x = 0; x < p.width; ++x)
                if (p.shows(x, y))
                    channel.push_back(static_cast<double>(
                        picture.pixels(c, static_cast<Index>(p.y0 + y) * picture.width + p.x0 + x)));
        around[c] = median(channel);
    }
    std::vector<Highlight> found;
    std::vector<bool> taken(p.value.size(), false);
    for (;;) {
        int best = -1;
        for (std::size_t i = 0; i < p.value.size(); ++i)
            if (!taken[i] && p.value[i] >= 0 &&
                (best < 0 || p.value[i] > p.value[static_cast<std::size_t>(best)]))
                best = static_cast<int>(i);
        if (best < 0) break;
        const double peak = static_cast<double>(p.value[static_cast<std::size_t>(best)]) - middle;
        if (peak < contrast) break;
        // All pixels beside it that are above its foot.
        Highlight h{Vec2<double>::Zero(), Vec3<double>::Zero(), 0, 0, true};
        std::vector<int> open{best};
        taken[static_cast<std::size_t>(best)] = true;
        double sum = 0, squares = 0;
        while (!open.empty()) {
            const int i = open.back(), x = i % p.width, y = i / p.width;
            open.pop_back();
            const double w = static_cast<double>(p.value[static_cast<std::size_t>(i)]) - middle;
            const Vec2<double> at(p.x0 + x + 0.5, p.y0 + y + 0.5);
            sum += w;
            squares += w * at.squaredNorm();
            h.at += w * at;
            h.amount += picture.pixels
                            .col(static_cast<Index>(p.y0 + y) * picture.width + p.x0 + x)
                            .head<3>()
                            .cast<double>() -
                        around;
            ++h.pixels;
            for (int dy = -1; dy <= 1; ++dy)
                for (int dx = -1; dx <= 1; ++dx) {
                    if (!p.shows(x + dx, y + dy)) {
                        h.whole = false;
                        continue;
                    }
                    const auto j = static_cast<std::size_t>((y + dy) * p.width + x + dx);
                    if (taken[j] || static_cast<double>(p.value[j]) - middle < foot * peak)
                        continue;
                    taken[j] = true;
                    open.push_back(static_cast<int>(j));
                }
        }
        h.at /= sum;
        h.spread = std::sqrt(std::max(0.0, (squares / sum - h.at.squaredNorm()) / 2));
        if (h.pixels <= largest * static_cast<double>(p.seen.size())) found.push_back(h);
    }
    return found;
}

} // namespace rye::trainer
