// SPDX-License-Identifier: Apache-2.0
#include "training/lights.hpp"

#include <algorithm>
#include <cmath>
#include <mutex>
#include <numbers>

#include <rye/autodiff/dual.hpp>
#include <rye/avatar/eye_optics.hpp>
#include <rye/capture/eye_sizes.hpp>
#include <rye/core/format.hpp>
#include <rye/math/levenberg.hpp>
#include <rye/math/rotation.hpp>
#include <rye/train/capture_subject.hpp>

#include "data/degrees.hpp"
#include "data/median.hpp"
#include "data/threads.hpp"

namespace rye::trainer {
namespace {

/// Angle within which mirrored directions are of one light before it is fitted.
constexpr double alike = 7 * degree;
/// Lights that are looked for; a capture with more has a sky.
constexpr std::size_t most_found = 4;
/// Fewest highlights of a light, and the share of the pictures that would show it.
constexpr int least_seen = 8;
constexpr double least_share = 0.25;
/// Standard deviation of a highlight's place: at least, and in parts of the iris' radius [px].
constexpr double least_sigma_px = 0.4, sigma_of_iris = 0.03;
/// Distance beyond which a highlight is not a light's, in those deviations.
constexpr double far = 5;
/// Residual, in deviations, from which a highlight counts less.
constexpr double huber = 1.5;
/// Standard deviations of the corneas' radius and of their centres' place, in parts of the radius,
/// about those of a textbook's eye.
constexpr double cornea_sigma = 0.06;
/// Distance at which lights begin, in radii of the eyeball.
constexpr double first_distance = 200;

/// A highlight with its picture's cornea.
struct Spot {
    CorneaInPicture of;
    std::size_t eye;
    Highlight shown;
    int light = -1; ///< or none
};

/// Radius of an iris in a picture [px].
double iris_px(const CorneaInPicture& of) {
    const double depth = of.camera.camera_from_world.apply(of.eye.translation).z();
    return of.camera.fx * of.eye.scale * of.limbus_radius / std::max(depth, 1e-9);
}
double sigma_px(const CorneaInPicture& of) {
    return std::max(least_sigma_px, sigma_of_iris * iris_px(of));
}

/// Returns the direction in the world that a highlight mirrors; 0 where it is not on the cornea.
Vec3<double> mirrored(const Spot& spot) {
    const CorneaInPicture& of = spot.of;
    const std::optional<Vec3<double>> at = of.under(spot.shown.at);
    if (!at) return Vec3<double>::Zero();
    const Vec3<double> n = (*at - of.cornea.centre) / of.cornea.radius,
                       v = normalized(Vec3<double>(into_eye(of.eye, of.camera.centre()) - *at));
    return of.eye.rotation * (2 * n.dot(v) * n - v);
}

/// Returns where a picture shows a light, and whether it does.
template <class T>
Vec2<T> image_of(const CorneaInPicture& of, const Cornea<T>& cornea, const Vec3<T>& light,
                 bool& seen) {
    const EyeTransform<double>& e = of.eye;
    const auto cast = [](const Vec3<double>& v) { return Vec3<T>(v.cast<T>()); };
    const Mat3<T> turn = e.rotation.cast<T>();
    const Vec3<T> there = (turn.transpose() * Vec3<T>(light - cast(e.translation))) / T(e.scale);
    const GlintView<T> view{cast(into_eye(e, of.camera.centre())), there, T(1)};
    const MirrorImage<T> image = mirror_image(cornea, view);
    seen = image.strength > T(0);
    const Vec3<T> world = turn * image.at * T(e.scale) + cast(e.translation);
    const Rigid<double>& c = of.camera.camera_from_world;
    const Vec3<T> at =
        Mat3<T>(c.rotation.cast<T>()) * world + cast(c.translation);
    return {T(of.camera.fx) * at[0] / at[2] + T(of.camera.cx),
            T(of.camera.fy) * at[1] / at[2] + T(of.camera.cy)};
}

/// Returns a cornea with another radius, and its centre elsewhere on its axis, both in parts of the
/// radius.
template <class T>
Cornea<T> changed(const Cornea<double>& c, const T& radius, const T& along) {
    Cornea<T> r;
    for (Index k = 0; k < 3; ++k) {
        r.axis[k] = T(c.axis[k]);
        r.centre[k] = T(c.centre[k]) + T(c.axis[k]) * T(c.radius) * along;
    }
    r.radius = T(c.radius) * (T(1) + radius);
    r.rim = T(c.rim);
    return r;
}

/// A frame's eyes as one camera sees them, visited for each eye that its mask shows.
template <class F>
void for_eye_pictures(const Capture& capture, const Subject& subject,
                      const std::array<Cornea<double>, 2>& corneas, bool pictures, F&& visit) {
    std::mutex reading; // for the capture's pictures
    program_threads().run(static_cast<Index>(capture.train.size()), [&](Index k) {
        const int f = capture.train[static_cast<std::size_t>(k)];
        const CaptureFrame& frame = capture.frames[static_cast<std::size_t>(f)];
        for (int c = 0; c < capture.camera_count(); ++c) {
            const CaptureView& view = capture.view(f, c);
            if (!view.present || view.eye_mask.empty()) continue;
            Image<float> eyes, picture;
            {
                const std::lock_guard<std::mutex> lock(reading);
                eyes = capture.eye_mask(f, c);
                if (pictures) picture = capture.image(f, c);
            }
            for (std::size_t e = 0; e < 2; ++e)
                visit(static_cast<std::size_t>(k), e, picture,
                      Columns<float>(eyes.pixels.row(static_cast<Index>(e))),
                      cornea_in_picture(frame, view.camera, subject, e, corneas[e]));
        }
    });
}

/// The fit of lights and corneas to spots.
struct LightFit {
    std::array<Cornea<double>, 2> corneas;
    const std::vector<Spot>& spots;
    Vec3<double> middle; ///< from which lights' places are counted

    /// Unknowns: changes of the corneas (2), then q of each light, whose place is
    /// middle + q / |q|^2: finite for lights that are far.
    Vec3<double> place(const VecX<double>& x, std::size_t light) const {
        const Vec3<double> q = x.segment<3>(2 + 3 * static_cast<Index>(light));
        return middle + q / q.squaredNorm();
    }
    std::array<Cornea<double>, 2> fitted(const VecX<double>& x) const {
        const auto of = [&](std::size_t e) {
            return changed<double>(corneas[e], cornea_sigma * x[0], cornea_sigma * x[1]);
        };
        return {of(0), of(1)};
    }
    NormalEquations<double> linearized(const VecX<double>& x) const {
        using D = Dual<double, 5>;
        NormalEquations<double> sum{0, Columns<double>::Zero(x.size(), x.size()),
                                    VecX<double>::Zero(x.size())};
        for (Index k = 0; k < 2; ++k) { // priors
            sum.cost += x[k] * x[k];
            sum.matrix(k, k) += 1;
            sum.gradient[k] += x[k];
        }
        for (const Spot& s : spots) {
            if (s.light < 0) continue;
            const Index at = 2 + 3 * static_cast<Index>(s.light);
            const D radius = D::variable(x[0], 0), along = D::variable(x[1], 1);
            Vec3<D> q, light;
            for (Index k = 0; k < 3; ++k) q[k] = D::variable(x[at + k], static_cast<int>(2 + k));
            const D square = dot(q, q);
            for (Index k = 0; k < 3; ++k) light[k] = D(middle[k]) + q[k] / square;
            bool seen = false;
            const Vec2<D> shown =
                image_of<D>(s.of, changed<D>(corneas[s.eye], D(cornea_sigma) * radius,
                                             D(cornea_sigma) * along),
                            light, seen);
            const double sigma = sigma_px(s.of);
            Vec2<double> r;
            Eigen::Matrix<double, 2, 5> j;
            for (Index k = 0; k < 2; ++k) {
                r[k] = (shown[k].value - s.shown.at[k]) / sigma;
                for (Index n = 0; n < 5; ++n)
                    j(k, n) = shown[k].d[static_cast<std::size_t>(n)] / sigma;
            }
            const double size = r.norm(), w = size <= huber ? 1 : huber / size;
            sum.cost += size <= huber ? size * size : huber * (2 * size - huber);
            const Eigen::Matrix<double, 5, 5> jj = w * j.transpose() * j;
            const Eigen::Matrix<double, 5, 1> jr = w * j.transpose() * r;
            const auto place_of = [&](Index n) { return n < 2 ? n : at + n - 2; };
            for (Index a = 0; a < 5; ++a) {
                sum.gradient[place_of(a)] += jr[a];
                for (Index b = 0; b < 5; ++b) sum.matrix(place_of(a), place_of(b)) += jj(a, b);
            }
        }
        return sum;
    }
};

/// Returns the direction that most spots mirror, of those that are free, and how many; marks none.
std::pair<Vec3<double>, int> densest(const std::vector<Vec3<double>>& all,
                                     const std::vector<bool>& free) {
    const double least = std::cos(alike);
    std::pair<Vec3<double>, int> best{Vec3<double>::Zero(), 0};
    for (std::size_t i = 0; i < all.size(); ++i) {
        if (!free[i]) continue;
        int count = 0;
        Vec3<double> sum = Vec3<double>::Zero();
        for (std::size_t j = 0; j < all.size(); ++j)
            if (free[j] && all[i].dot(all[j]) > least) {
                ++count;
                sum += all[j];
            }
        if (count > best.second) best = {normalized(sum), count};
    }
    return best;
}

} // namespace

CorneaInPicture cornea_in_picture(const CaptureFrame& frame, const Pinhole<double>& camera,
                                  const Subject& subject, std::size_t eye,
                                  const Cornea<double>& cornea) {
    const CaptureEye& label = frame.eyes[eye];
    const HeadPlacement<double> head{
        {so3_exp(Vec3<double>(frame.pose.head<3>())), Vec3<double>(frame.pose.tail<3>())},
        frame.scale};
    const Vec3<double> centre = subject.measured_eyes && label.centre
                                    ? Vec3<double>(to_canonical(frame, *label.centre))
                                    : subject.eye_centre[eye];
    return {camera, eye_transform(EyeDrive<double>{centre, Vec3<double>::Zero(), label.optical},
                                  head),
            cornea, subject.limbus_radius[eye]};
}

FoundLights find_lights(const Capture& capture, const Subject& subject) {
    FoundLights found;
    for (std::size_t e = 0; e < 2; ++e)
        found.corneas[e] = cornea_of<double>(eyeball_shape(subject.sizes(e)));
    if (!capture.has_gaze()) return found;
    const std::size_t frames = capture.train.size();
    std::vector<std::vector<Spot>> of_frame(frames);
    std::vector<int> looked(frames, 0);
    for_eye_pictures(capture, subject, found.corneas, true,
                     [&](std::size_t k, std::size_t eye, const Image<float>& picture,
                         const Columns<float>& area, const CorneaInPicture& of) {
                         for (const Highlight& h : find_highlights(picture, area, of))
                             if (h.whole) of_frame[k].push_back({of, eye, h});
                         looked[k] += area.maxCoeff() > 0.5F ? 1 : 0;
                     });
    std::vector<Spot> spots;
    for (std::size_t k = 0; k < frames; ++k) {
        found.eyes += looked[k];
        spots.insert(spots.end(), of_frame[k].begin(), of_frame[k].end());
    }
    found.highlights = static_cast<int>(spots.size());
    if (spots.empty()) return found;

    // Directions that many share.
    std::vector<Vec3<double>> directions;
    Vec3<double> middle = Vec3<double>::Zero();
    for (const Spot& s : spots) {
        directions.push_back(mirrored(s));
        middle += s.of.eye.translation / static_cast<double>(spots.size());
    }
    std::vector<bool> free(spots.size(), true);
    std::vector<Vec3<double>> toward;
    while (toward.size() < most_found) {
        const auto [direction, count] = densest(directions, free);
        if (count < least_seen) break;
        for (std::size_t i = 0; i < spots.size(); ++i)
            if (free[i] && directions[i].dot(direction) > std::cos(2 * alike)) {
                if (directions[i].dot(direction) > std::cos(alike))
                    spots[i].light = static_cast<int>(toward.size());
                free[i] = false;
            }
        toward.push_back(direction);
    }
    if (toward.empty()) return found;
    const double radius = spots.front().of.eye.scale * subject.eye_radius[0];
    VecX<double> x = VecX<double>::Zero(2 + 3 * static_cast<Index>(toward.size()));
    for (std::size_t l = 0; l < toward.size(); ++l)
        x.segment<3>(2 + 3 * static_cast<Index>(l)) = toward[l] / (first_distance * radius);

    const LightFit fit{found.corneas, spots, middle};
    for (int round = 0; round < 4; ++round) {
        LevenbergSettings settings;
        settings.steps = 20;
        x = levenberg<double>(
                x, settings, [&](const VecX<double>& at) { return fit.linearized(at); },
                [&](const VecX<double>& at) { return fit.linearized(at).cost; })
                .x;
        const std::array<Cornea<double>, 2> corneas = fit.fitted(x);
        for (Spot& s : spots) {
            s.light = -1;
            double nearest = far * sigma_px(s.of);
            for (std::size_t l = 0; l < toward.size(); ++l) {
                bool seen = false;
                const Vec2<double> at =
                    image_of<double>(s.of, corneas[s.eye], fit.place(x, l), seen);
                const double off = (at - s.shown.at).norm();
                if (!seen || !(off < nearest)) continue;
                nearest = off;
                s.light = static_cast<int>(l);
            }
        }
    }
    found.corneas = fit.fitted(x);

    // How often each light would be seen.
    std::vector<FoundLight> lights(toward.size());
    std::vector<std::vector<int>> expected(frames, std::vector<int>(toward.size(), 0));
    for (std::size_t l = 0; l < toward.size(); ++l) lights[l].position = fit.place(x, l);
    for_eye_pictures(capture, subject, found.corneas, false,
                     [&](std::size_t k, std::size_t, const Image<float>&,
                         const Columns<float>& area, const CorneaInPicture& of) {
                         if (!(area.maxCoeff() > 0.5F)) return;
                         for (std::size_t l = 0; l < lights.size(); ++l) {
                             bool seen = false;
                             const Vec2<double> at =
                                 image_of<double>(of, of.cornea, lights[l].position, seen);
                             if (seen && shows_cornea(area, of, at)) ++expected[k][l];
                         }
                     });
    for (std::size_t l = 0; l < lights.size(); ++l) {
        FoundLight& light = lights[l];
        for (const std::vector<int>& n : expected) light.expected += n[l];
        std::vector<double> errors, widths;
        for (const Spot& s : spots) {
            if (s.light != static_cast<int>(l)) continue;
            bool seen = false;
            errors.push_back(
                (image_of<double>(s.of, found.corneas[s.eye], light.position, seen) - s.shown.at)
                    .norm());
            // Less what a pixel's square adds.
            const double spread = std::sqrt(std::max(0.05, s.shown.spread * s.shown.spread -
                                                               1.0 / 12));
            widths.push_back(spread * s.of.limbus_radius / iris_px(s.of));
        }
        light.seen = static_cast<int>(errors.size());
        light.error_px = median(errors);
        light.width = median(widths);
        for (Index c = 0; c < 3; ++c) {
            std::vector<double> heights;
            for (const Spot& s : spots)
                if (s.light == static_cast<int>(l)) {
                    const double px = light.width * iris_px(s.of) / s.of.limbus_radius;
                    heights.push_back(s.shown.amount[c] / (2 * std::numbers::pi * px * px));
                }
            light.intensity[c] = std::max(0.0, median(heights));
        }
        if (light.seen >= least_seen && light.seen >= least_share * light.expected)
            found.lights.push_back(light);
    }
    return found;
}

std::vector<std::string> FoundLights::lines() const {
    const std::string looked = std::to_string(highlights) + " highlights in " +
                               std::to_string(eyes) + " pictures of an eye";
    if (lights.empty()) return {"lights         none found: " + looked};
    std::vector<std::string> lines;
    for (const FoundLight& l : lights) {
        const Vec3<double> to = l.position.normalized();
        lines.push_back(
            "light          " + number_text(std::round(std::atan2(to.x(), to.z()) / degree)) +
            " degrees aside, " + number_text(std::round(std::asin(to.y()) / degree)) +
            " up: seen in " + std::to_string(l.seen) + " of " + std::to_string(l.expected) +
            " pictures of an eye that would show it, " +
            number_text(std::round(100 * l.error_px) / 100) + " px from where it belongs");
    }
    return lines;
}

void set_lights(Avatar& avatar, const FoundLights& found) {
    if (found.lights.empty()) return;
    EyeOptics<float, TrainEffects>& optics = avatar.eyes.optics;
    const auto cornea = [&](std::size_t e) {
        const Cornea<double>& c = found.corneas[e];
        return Cornea<float>{Vec3<float>(c.centre.cast<float>()), static_cast<float>(c.radius),
                             Vec3<float>(c.axis.cast<float>()), static_cast<float>(c.rim)};
    };
    set_corneas(optics, cornea(0), cornea(1));
    resize_lights(optics, static_cast<Index>(found.lights.size()));
    // Gaussians that are farther apart than an image is wide do not show it.
    const double apart = static_cast<double>(avatar.eyes.spacing.minCoeff());
    for (std::size_t l = 0; l < found.lights.size(); ++l) {
        const FoundLight& light = found.lights[l];
        const auto at = static_cast<Index>(l);
        optics.light_position.col(at) = light.position.cast<float>();
        optics.light_intensity.col(at) = light.intensity.cast<float>();
        optics.light_width(0, at) = static_cast<float>(std::max(light.width, apart));
    }
}

} // namespace rye::trainer
