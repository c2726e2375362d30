// SPDX-License-Identifier: Apache-2.0
#include "corrections/reflections.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include <rye/rig/gaze.hpp>

#include "data/degrees.hpp"
#include "data/median.hpp"

namespace rye::trainer {
namespace {

/// Share of the limbus' radius within which pixels count: beyond it the sclera may show where a
/// gaze's label is off.
constexpr double inner = 0.88;
/// Cells of the iris along its diameter.
constexpr int cells = 20;
/// Sides of a map's parts [deg], and the fewest pixels of one, where photographs and renders are
/// compared.
constexpr double compared_side = 6;
constexpr int compared_least = 20;

/// Returns each channel's median over a group of pixels.
Vec3<float> median_colour(const std::vector<const MirroredPixel*>& pixels) {
    Vec3<float> m;
    for (Index c = 0; c < 3; ++c) {
        std::vector<double> values;
        for (const MirroredPixel* p : pixels) values.push_back(static_cast<double>(p->colour[c]));
        m[c] = static_cast<float>(median(std::move(values)));
    }
    return m;
}

/// Subtracts each group's medians from its pixels' colours.
template <class Key>
void subtract_medians(std::vector<MirroredPixel>& pixels, const Key& key) {
    std::map<int, std::vector<const MirroredPixel*>> groups;
    for (const MirroredPixel& p : pixels) groups[key(p)].push_back(&p);
    std::map<int, Vec3<float>> medians_of;
    for (const auto& [k, group] : groups) medians_of[k] = median_colour(group);
    for (MirroredPixel& p : pixels) p.colour -= medians_of.at(key(p));
}

} // namespace

void add_mirrored_pixels(const Image<float>& picture, const Columns<float>& area,
                         const CorneaInPicture& of, int eye, int number,
                         std::vector<MirroredPixel>& all) {
    const Vec3<double> centre = of.eye.apply(of.cornea.centre);
    const double depth = of.camera.camera_from_world.apply(centre).z();
    if (!(depth > of.camera.near_depth)) return;
    const Vec2<double> middle = of.camera.project_point(centre).head<2>();
    const double reach = of.camera.fx * of.eye.scale * of.cornea.radius / depth + 1;
    if (!(middle.allFinite() && reach < 1e5)) return;
    const auto inside = [](double v, int side) {
        return static_cast<int>(std::clamp(v, 0.0, static_cast<double>(side)));
    };
    const double limbus = of.camera.fx * of.eye.scale * of.limbus_radius / depth;
    const Vec3<double> from = into_eye(of.eye, of.camera.centre());
    for (int y = inside(middle.y() - reach, picture.height);
         y < inside(middle.y() + reach + 1, picture.height); ++y)
        for (int x = inside(middle.x() - reach, picture.width);
             x < inside(middle.x() + reach + 1, picture.width); ++x) {
            const Index i = static_cast<Index>(y) * picture.width + x;
            if (!(area(0, i) > 0.5F)) continue;
            const Vec3<double> far = into_eye(
                of.eye,
                Vec3<double>(of.camera.centre() + depth * of.camera.ray({x + 0.5, y + 0.5})));
            const detail::MirrorRay<double> ray(of.cornea, from, far);
            if (!(ray.inside > 0)) continue;
            const Vec3<double> at = of.cornea.centre + of.cornea.radius * ray.normal;
            const Vec3<double> aside = at - at.dot(of.cornea.axis) * of.cornea.axis;
            if (at.dot(of.cornea.axis) < of.cornea.rim || aside.norm() > inner * of.limbus_radius)
                continue;
            const Vec3<double> to = of.eye.rotation * (ray.view - 2 * ray.facing * ray.normal);
            all.push_back({to.cast<float>(), picture.pixels.col(i).head<3>(),
                           Vec2<float>((aside.head<2>() / of.limbus_radius).cast<float>()), eye,
                           number, x, y, static_cast<float>(limbus)});
        }
}

void subtract_own_colours(std::vector<MirroredPixel>& pixels) {
    const auto cell = [](float v) {
        return std::clamp(static_cast<int>((v + 1) * cells / 2), 0, cells - 1);
    };
    subtract_medians(pixels, [&](const MirroredPixel& p) {
        return (p.eye * cells + cell(p.iris.y())) * cells + cell(p.iris.x());
    });
    subtract_medians(pixels, [](const MirroredPixel& p) { return p.picture; });
}

std::vector<ReflectedPart> reflected_parts(std::vector<MirroredPixel> pixels, double side,
                                           int least, const KnownLight& known) {
    std::vector<Vec3<float>> lights;
    if (known)
        for (MirroredPixel& p : pixels) {
            lights.push_back(known(p.to));
            p.colour -= lights.back();
        }
    subtract_own_colours(pixels);
    for (std::size_t i = 0; i < lights.size(); ++i) pixels[i].colour += lights[i];
    std::map<std::pair<int, int>, ReflectedPart> parts;
    for (const MirroredPixel& p : pixels) {
        const Vec2<double> angles = pitch_yaw(Vec3<double>(p.to.cast<double>())) / degree;
        const auto place = std::pair(static_cast<int>(std::floor(angles[0] / side)),
                                     static_cast<int>(std::floor(angles[1] / side)));
        const auto part =
            parts.try_emplace(place, ReflectedPart{Vec3<double>::Zero(), Vec3<double>::Zero(), 0})
                .first;
        part->second.to += p.to.cast<double>();
        part->second.colour += p.colour.cast<double>();
        ++part->second.pixels;
    }
    std::vector<ReflectedPart> all;
    for (auto& [place, part] : parts) {
        if (part.pixels < least) continue;
        part.to.normalize();
        part.colour /= part.pixels;
        all.push_back(part);
    }
    return all;
}

void Reflections::add(const Reflections& r) {
    const auto append = [&](std::vector<MirroredPixel>& to,
                            const std::vector<MirroredPixel>& from) {
        for (MirroredPixel p : from) {
            p.picture += pictures;
            to.push_back(p);
        }
    };
    append(photograph, r.photograph);
    append(render, r.render);
    pictures += r.pictures;
}

nlohmann::ordered_json Reflections::json() const {
    nlohmann::ordered_json r = {{"correlation", nullptr},
                                {"photographs", nullptr},
                                {"renders", nullptr},
                                {"directions", 0}};
    const std::vector<ReflectedPart> a = reflected_parts(photograph, compared_side, compared_least),
                                     b = reflected_parts(render, compared_side, compared_least);
    if (a.size() != b.size() || a.size() < 8) return r;
    // Both have the same pixels, and so the same parts.
    double n = 0, sx = 0, sy = 0, sxx = 0, syy = 0, sxy = 0;
    for (std::size_t k = 0; k < a.size(); ++k) {
        const double w = a[k].pixels, x = a[k].colour.mean(), y = b[k].colour.mean();
        n += w, sx += w * x, sy += w * y, sxx += w * x * x, syy += w * y * y, sxy += w * x * y;
    }
    const double xx = std::max(0.0, sxx / n - sx / n * (sx / n)),
                 yy = std::max(0.0, syy / n - sy / n * (sy / n)), xy = sxy / n - sx / n * (sy / n);
    if (xx > 0 && yy > 0) r["correlation"] = xy / std::sqrt(xx * yy);
    r["photographs"] = std::sqrt(xx);
    r["renders"] = std::sqrt(yy);
    r["directions"] = a.size();
    return r;
}

} // namespace rye::trainer
