// SPDX-License-Identifier: Apache-2.0
#include "corrections/reflections.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include <rye/math/levenberg.hpp>
#include <rye/rig/gaze.hpp>

#include "data/degrees.hpp"
#include "data/median.hpp"

namespace rye::trainer {
namespace {

/// Share of the limbus' radius within which pixels count: beyond it the sclera may show where a
/// gaze's label is off.
constexpr double inner = 0.88;
/// Parts of the iris along its diameter.
constexpr int cells = 30;
/// Times that colours and gains are fitted in turn, those of a picture's fit, and the residual at
/// which a pixel weighs half in it.
constexpr int turns = 4, fits = 5;
constexpr double half_weight = 0.03;
/// Weights that keep a picture's gain at 1, its slopes and its offset at 0; of the slopes, a pixel.
constexpr double at_rest = 1e-3, slope_at_rest = 1e-3;
/// Least gain of a pixel.
constexpr double least_gain = 0.05;
/// Sides of a map's parts [deg], and the fewest pixels of one, where photographs and renders are
/// compared.
constexpr double compared_side = 6;
constexpr int compared_least = 20;

/// How a picture shows an iris: what it multiplies colours by, and adds to them.
struct PictureLight {
    Vec4<double> numbers{1, 0, 0, 0}; ///< gain in the middle, its slopes over the iris, offset

    double gain(const MirroredPixel& p) const {
        return std::max(least_gain, numbers[0] + numbers[1] * static_cast<double>(p.iris.x()) +
                                        numbers[2] * static_cast<double>(p.iris.y()));
    }
    /// Fits it to pixels whose irises have these brightnesses.
    void fit(const std::vector<const MirroredPixel*>& pixels, const std::vector<double>& own) {
        const auto count = static_cast<double>(pixels.size());
        for (int turn = 0; turn < fits; ++turn) {
            Columns<double> matrix = Columns<double>::Zero(4, 4);
            matrix.diagonal() << at_rest, at_rest + slope_at_rest * count,
                at_rest + slope_at_rest * count, at_rest;
            VecX<double> right = VecX<double>::Zero(4);
            right[0] = at_rest;
            for (std::size_t i = 0; i < pixels.size(); ++i) {
                const MirroredPixel& p = *pixels[i];
                const double value = static_cast<double>(p.colour.mean());
                VecX<double> row(4);
                row << own[i], own[i] * static_cast<double>(p.iris.x()),
                    own[i] * static_cast<double>(p.iris.y()), 1;
                const double r = (value - row.dot(VecX<double>(numbers))) / half_weight,
                             w = 1 / (1 + r * r);
                matrix += w * row * row.transpose();
                right += w * value * row;
            }
            numbers = covariance<double>(matrix) * right;
        }
    }
};

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
            const double down = -ray.view.dot(of.cornea.axis);
            if (!(down > 0)) continue;
            const Vec3<double> iris =
                at + (at.dot(of.cornea.axis) - of.iris_plane) / down * ray.view;
            const Vec3<double> to = of.eye.rotation * (ray.view - 2 * ray.facing * ray.normal);
            all.push_back({to.cast<float>(), picture.pixels.col(i).head<3>(),
                           Vec2<float>((iris.head<2>() / of.limbus_radius).cast<float>()), eye,
                           number, x, y, static_cast<float>(limbus)});
        }
}

void subtract_own_colours(std::vector<MirroredPixel>& pixels) {
    const auto cell = [](float v) {
        return std::clamp(static_cast<int>((v + 1) * cells / 2), 0, cells - 1);
    };
    const auto place = [&](const MirroredPixel& p) {
        return (p.eye * cells + cell(p.iris.y())) * cells + cell(p.iris.x());
    };
    std::map<int, std::vector<const MirroredPixel*>> of_place, of_picture;
    for (const MirroredPixel& p : pixels) {
        of_place[place(p)].push_back(&p);
        of_picture[p.picture].push_back(&p);
    }
    std::map<int, Vec3<double>> own;
    std::map<int, PictureLight> lights;
    for (int turn = 0; turn < turns; ++turn) {
        for (const auto& [k, group] : of_place)
            for (Index c = 0; c < 3; ++c) {
                std::vector<double> values;
                for (const MirroredPixel* p : group) {
                    const PictureLight& light = lights[p->picture];
                    values.push_back((static_cast<double>(p->colour[c]) - light.numbers[3]) /
                                     light.gain(*p));
                }
                own[k][c] = median(std::move(values));
            }
        for (const auto& [k, group] : of_picture) {
            std::vector<double> brightness;
            for (const MirroredPixel* p : group) brightness.push_back(own.at(place(*p)).mean());
            lights[k].fit(group, brightness);
        }
    }
    for (MirroredPixel& p : pixels) {
        const PictureLight& light = lights.at(p.picture);
        const Vec3<double> without =
            light.gain(p) * own.at(place(p)) + Vec3<double>::Constant(light.numbers[3]);
        p.colour -= without.cast<float>();
    }
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
