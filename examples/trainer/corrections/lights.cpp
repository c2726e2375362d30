// SPDX-License-Identifier: Apache-2.0
#include "corrections/lights.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include <rye/autodiff/dual.hpp>
#include <rye/avatar/eye_optics.hpp>
#include <rye/io/eye_sizes.hpp>
#include <rye/math/levenberg.hpp>
#include <rye/math/rotation.hpp>
#include <rye/train/capture_subject.hpp>

#include "data/degrees.hpp"
#include "data/json_fields.hpp"
#include "data/median.hpp"
#include "data/threads.hpp"

namespace rye::trainer {
namespace {

/// Sides of the map's parts [deg]: the first of which leaves this share of the pixels in parts of
/// so many.
constexpr std::array sides{3.0, 4.0, 6.0, 8.0};
constexpr double least_share = 0.7;
constexpr int least_pixels = 15;
/// Times that the map is made, each with irises' own colours judged without the last lights.
constexpr int rounds = 3;
/// Pixels beyond which a part counts no more, and the fewest about a peak.
constexpr double most_weight = 60, least_support = 100;
/// Lobes that are looked for, the width that one begins with, and the angle within which a peak is
/// averaged, in sides of a part.
constexpr std::size_t most_lobes = 6;
constexpr double first_width = 9 * degree, peak_sides = 1.7;
/// Widths that a lobe may have.
constexpr double narrow = 2 * degree, wide = 35 * degree;
/// A light's height: at least, and in deviations of the map's peaks.
constexpr double least_height = 0.03, deviations = 2.5;
/// Distance of lights, in radii of the eyeball: far.
constexpr double distance_in_radii = 1000;
/// Distance of a file's lights that have a direction alone [world units], and bounds of its
/// numbers: of lengths, of intensities, of widths [rad].
constexpr double far_away = 1e6, most_length = 1e9, most_intensity = 1000;
constexpr double least_width = 1e-3, most_width = 3.2;

/// A lobe of the map's mean channel.
struct Lobe {
    Vec3<double> to;
    double width, height;

    double at(const Vec3<double>& direction) const {
        return height * light_lobe(direction, to, width);
    }
};

/// Returns two unit vectors across a direction.
std::array<Vec3<double>, 2> across(const Vec3<double>& to) {
    const Vec3<double> x = normalized(
        cross(std::abs(to.y()) < 0.9 ? Vec3<double>(0, 1, 0) : Vec3<double>(1, 0, 0), to));
    return {x, cross(to, x)};
}

double weight_of(const ReflectedPart& p) { return std::min<double>(p.pixels, most_weight); }

/// The map less its lobes and an offset.
struct LobeFit {
    const std::vector<ReflectedPart>& map;
    double side; ///< of a part [deg]
    std::vector<Lobe> lobes;
    double offset = 0;

    double residual(const ReflectedPart& p) const {
        double r = p.colour.mean() - offset;
        for (const Lobe& l : lobes) r -= l.at(p.to);
        return r;
    }

    /// Returns the lobe after steps across its direction (2), of the logarithm of its width, and of
    /// its height.
    template <class T>
    static T stepped(const Lobe& l, const Vec3<double>& direction, const Vec4<T>& step) {
        using std::exp;
        const auto [x, y] = across(l.to);
        Vec3<T> to, there;
        for (Index k = 0; k < 3; ++k) {
            to[k] = T(l.to[k]) + step[0] * T(x[k]) + step[1] * T(y[k]);
            there[k] = T(direction[k]);
        }
        return (T(l.height) + step[3]) *
               light_lobe(there, normalized(to), T(T(l.width) * exp(step[2])));
    }

    /// Refits all lobes and the offset together.
    void refit() {
        const Index n = 4 * static_cast<Index>(lobes.size()) + 1;
        const auto linearized = [&](const VecX<double>& x) {
            using D = Dual<double, 4>;
            NormalEquations<double> sum{0, Columns<double>::Zero(n, n), VecX<double>::Zero(n)};
            // Priors that keep a lobe's direction and width near where it began.
            for (Index k = 0; k + 1 < n; ++k) {
                const double weight = k % 4 == 3 ? 0 : 0.05; // heights have none
                sum.cost += weight * x[k] * x[k];
                sum.matrix(k, k) += weight;
                sum.gradient[k] += weight * x[k];
            }
            for (const ReflectedPart& p : map) {
                double r = x[n - 1] + offset - p.colour.mean();
                VecX<double> j = VecX<double>::Zero(n);
                j[n - 1] = 1;
                for (std::size_t l = 0; l < lobes.size(); ++l) {
                    const Index at = 4 * static_cast<Index>(l);
                    Vec4<D> step;
                    for (Index k = 0; k < 4; ++k)
                        step[k] = D::variable(x[at + k], static_cast<int>(k));
                    const D value = stepped<D>(lobes[l], p.to, step);
                    r += value.value;
                    for (Index k = 0; k < 4; ++k) j[at + k] = value.d[static_cast<std::size_t>(k)];
                }
                const double w = weight_of(p);
                sum.cost += w * r * r;
                sum.matrix += w * j * j.transpose();
                sum.gradient += w * r * j;
            }
            return sum;
        };
        LevenbergSettings settings;
        settings.steps = 15;
        const VecX<double> x =
            levenberg<double>(VecX<double>::Zero(n), settings, linearized,
                              [&](const VecX<double>& at) { return linearized(at).cost; })
                .x;
        offset += x[n - 1];
        for (std::size_t l = 0; l < lobes.size(); ++l) {
            const auto at = x.segment<4>(4 * static_cast<Index>(l));
            Lobe& lobe = lobes[l];
            const auto [side_x, side_y] = across(lobe.to);
            lobe.to = normalized(Vec3<double>(lobe.to + at[0] * side_x + at[1] * side_y));
            lobe.width = std::clamp(lobe.width * std::exp(at[2]), narrow, wide);
            lobe.height += at[3];
        }
    }

    /// Returns the direction about which the residual is largest, and its mean there; the deviation
    /// of such means in the second place.
    std::pair<Lobe, double> peak() const {
        Lobe best{Vec3<double>::Zero(), first_width, 0};
        std::vector<double> heights;
        const double near = std::cos(peak_sides * side * degree);
        for (const ReflectedPart& p : map) {
            double sum = 0, weights = 0;
            for (const ReflectedPart& q : map)
                if (p.to.dot(q.to) > near) {
                    sum += weight_of(q) * residual(q);
                    weights += weight_of(q);
                }
            if (weights < least_support) continue;
            heights.push_back(std::abs(sum / weights));
            if (sum / weights > best.height) {
                best.to = p.to;
                best.height = sum / weights;
            }
        }
        return {best, 1.4826 * median(heights)};
    }
};

/// A map, and the sides of its parts [deg].
struct ReflectedMap {
    std::vector<ReflectedPart> parts;
    double side = 0;
};
constexpr std::size_t least_parts = 50;

/// Returns the map, of parts as small as the number of pixels allows.
ReflectedMap reflected_map(const std::vector<MirroredPixel>& pixels, const KnownLight& known) {
    ReflectedMap map;
    for (const double side : sides) {
        map = {reflected_parts(pixels, side, least_pixels, known), side};
        double held = 0;
        for (const ReflectedPart& p : map.parts) held += p.pixels;
        if (held >= least_share * static_cast<double>(pixels.size())) break;
    }
    return map;
}

/// Sets the lights that explain a map, brightest first, and the share of it that they explain.
void fit_lights(const ReflectedMap& map, FoundLights& found) {
    LobeFit fit{map.parts, map.side, {}};
    double before = 0, after = 0;
    for (const ReflectedPart& p : map.parts) before += weight_of(p) * std::pow(p.colour.mean(), 2);
    while (fit.lobes.size() < most_lobes) {
        const auto [lobe, deviation] = fit.peak();
        if (lobe.height < std::max(least_height, deviations * deviation)) break;
        fit.lobes.push_back(lobe);
        fit.refit();
    }
    std::erase_if(fit.lobes, [](const Lobe& l) { return l.height < least_height; });
    for (const ReflectedPart& p : map.parts) after += weight_of(p) * std::pow(fit.residual(p), 2);
    found.explained = before > 0 ? 1 - after / before : 0;

    // Heights of each channel, the lobes' shapes as they are.
    const Index n = static_cast<Index>(fit.lobes.size());
    if (n == 0) return;
    Columns<double> matrix = Columns<double>::Zero(n + 1, n + 1),
                    right = Columns<double>::Zero(n + 1, 3);
    for (const ReflectedPart& p : map.parts) {
        VecX<double> row = VecX<double>::Ones(n + 1);
        for (Index l = 0; l < n; ++l) {
            const Lobe& lobe = fit.lobes[static_cast<std::size_t>(l)];
            row[l] = light_lobe(p.to, lobe.to, lobe.width);
        }
        matrix += weight_of(p) * row * row.transpose();
        right += weight_of(p) * row * p.colour.transpose();
    }
    const Columns<double> heights = covariance<double>(matrix) * right;
    for (Index l = 0; l < n; ++l) {
        const Lobe& lobe = fit.lobes[static_cast<std::size_t>(l)];
        found.lights.push_back(
            {lobe.to, Vec3<double>(heights.row(l).transpose().cwiseMax(0.0)), lobe.width});
    }
    std::sort(found.lights.begin(), found.lights.end(),
              [](const FoundLight& a, const FoundLight& b) {
                  return a.intensity.mean() > b.intensity.mean();
              });
}

void take_corneas(Avatar& avatar, const std::array<Cornea<double>, 2>& both) {
    const auto cornea = [&](std::size_t e) {
        const Cornea<double>& c = both[e];
        return Cornea<float>{Vec3<float>(c.centre.cast<float>()), static_cast<float>(c.radius),
                             Vec3<float>(c.axis.cast<float>()), static_cast<float>(c.rim)};
    };
    set_corneas(avatar.eyes.optics, cornea(0), cornea(1));
}

} // namespace

Cornea<double> usual_cornea(const Subject& subject, std::size_t eye) {
    return cornea_of<double>(eyeball_shape(subject.sizes(eye)));
}

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
    return {camera,
            eye_transform(EyeDrive<double>{centre, Vec3<double>::Zero(), label.optical}, head),
            cornea, subject.limbus_radius[eye], subject.sizes(eye).iris_plane};
}

FoundLights find_lights(const Capture& capture, const Subject& subject) {
    FoundLights found;
    for (std::size_t e = 0; e < 2; ++e) found.corneas[e] = usual_cornea(subject, e);
    if (!capture.has_gaze()) return found;
    const std::size_t frames = capture.train.size();
    const int views = capture.camera_count();
    std::vector<std::vector<MirroredPixel>> of_frame(frames);
    std::vector<int> looked(frames, 0);
    program_threads().run(static_cast<Index>(frames), [&](Index k) {
        const auto i = static_cast<std::size_t>(k);
        const int f = capture.train[i];
        const CaptureFrame& frame = capture.frames[static_cast<std::size_t>(f)];
        for (int c = 0; c < views; ++c) {
            const CaptureView& view = capture.view(f, c);
            if (!view.present || view.eye_mask.empty()) continue;
            const Image<float> eyes = capture.eye_mask(f, c), picture = capture.image(f, c);
            for (int e = 0; e < 2; ++e) {
                const Columns<float> area = eyes.pixels.row(e);
                if (!(area.maxCoeff() > 0.5F)) continue;
                ++looked[i];
                add_mirrored_pixels(
                    picture, area,
                    cornea_in_picture(frame, view.camera, subject, static_cast<std::size_t>(e),
                                      found.corneas[static_cast<std::size_t>(e)]),
                    e, (static_cast<int>(k) * views + c) * 2 + e, of_frame[i]);
            }
        }
    });
    std::vector<MirroredPixel> pixels;
    for (std::size_t i = 0; i < frames; ++i) {
        found.pictures += looked[i];
        pixels.insert(pixels.end(), of_frame[i].begin(), of_frame[i].end());
        const CaptureFrame& frame = capture.frames[static_cast<std::size_t>(capture.train[i])];
        const Mat3<double> turn = so3_exp(Vec3<double>(frame.pose.head<3>()));
        const Vec3<double> between = 0.5 * (subject.eye_centre[0] + subject.eye_centre[1]);
        found.middle +=
            (frame.scale * (turn * between) + frame.pose.tail<3>()) / static_cast<double>(frames);
        found.distance = distance_in_radii * frame.scale * subject.eye_radius[0];
    }
    for (int round = 0; round < rounds; ++round) {
        const std::vector<FoundLight> last = found.lights;
        const ReflectedMap map = reflected_map(pixels, [&](const Vec3<float>& to) {
            Vec3<double> sum = Vec3<double>::Zero();
            for (const FoundLight& l : last)
                sum += l.intensity * light_lobe(Vec3<double>(to.cast<double>()), l.to, l.width);
            return Vec3<float>(sum.cast<float>());
        });
        found.lights.clear();
        if (map.parts.size() < least_parts) return found;
        fit_lights(map, found);
        if (found.lights.empty()) return found;
    }
    return found;
}

std::vector<std::string> FoundLights::lines() const {
    if (lights.empty())
        return {"no light was found on the corneas in " + std::to_string(pictures) +
                " pictures of an eye"};
    std::vector<std::string> lines;
    for (const FoundLight& l : lights) {
        const Vec2<double> at = pitch_yaw(l.to) / degree;
        char text[160];
        std::snprintf(text, sizeof text,
                      "a light %.0f degrees aside and %.0f up, %.0f wide: its highlight adds %.3f",
                      at[1], at[0], 2 * l.width / degree, l.intensity.mean());
        lines.emplace_back(text);
    }
    return lines;
}

nlohmann::ordered_json FoundLights::json() const {
    nlohmann::ordered_json all = nlohmann::ordered_json::array();
    for (const FoundLight& l : lights) {
        const Vec3<double>& at = l.position ? *l.position : l.to;
        all.push_back({{l.position ? "position" : "to", {at[0], at[1], at[2]}},
                       {"intensity", {l.intensity[0], l.intensity[1], l.intensity[2]}},
                       {"width", l.width}});
    }
    return {{"pictures", pictures}, {"explained", explained}, {"lights", all}};
}

void begin_refraction(Avatar& avatar, const Subject& subject) {
    if (avatar.eyes.optics.cornea.size() == 0)
        take_corneas(avatar, {usual_cornea(subject, 0), usual_cornea(subject, 1)});
    set_refraction(avatar.eyes.optics, detail::corneal_index);
}

void set_lights(Avatar& avatar, const FoundLights& found) {
    if (found.lights.empty()) return;
    take_corneas(avatar, found.corneas);
    replace_lights(avatar, found);
}

void replace_lights(Avatar& avatar, const FoundLights& lights) {
    EyeOptics<float, TrainEffects>& optics = avatar.eyes.optics;
    resize_lights(optics, static_cast<Index>(lights.lights.size()));
    for (std::size_t l = 0; l < lights.lights.size(); ++l) {
        const FoundLight& light = lights.lights[l];
        const auto at = static_cast<Index>(l);
        const Vec3<double> far = lights.middle + lights.distance * light.to;
        optics.light_position.col(at) = light.position.value_or(far).cast<float>();
        optics.light_intensity.col(at) = light.intensity.cast<float>();
        optics.light_width(0, at) = static_cast<float>(light.width);
    }
}

FoundLights lights_of(const Avatar& avatar) {
    const EyeOptics<float, TrainEffects>& optics = avatar.eyes.optics;
    FoundLights all;
    for (Index l = 0; l < optics.lights(); ++l) {
        const Vec3<double> at = optics.light_position.col(l).cast<double>();
        all.lights.push_back({normalized(at), optics.light_intensity.col(l).cast<double>(),
                              static_cast<double>(optics.light_width(0, l)), at});
    }
    return all;
}

FoundLights read_lights(const std::filesystem::path& path) {
    const nlohmann::json file = read_json(path);
    const nlohmann::json* list = &file;
    while (list->is_object() && list->contains("lights")) list = &list->at("lights");
    const std::string name = path.string() + ": lights";
    require(
        list->is_array() && list->size() <= std::size_t(most_lights), name, "got ",
        [&] { return json_excerpt(*list); }, ", expected a list of at most ", most_lights,
        " lights, as `rye info --json` prints it");
    FoundLights all;
    all.distance = far_away;
    for (const nlohmann::json& light : *list) {
        const std::string who = name + "[" + std::to_string(all.lights.size()) + "]";
        const auto vector = [&](const char* key, double most) {
            const nlohmann::json& of = json_list(light, key, who, "a list of three numbers");
            Vec3<double> v;
            require(
                of.size() == 3, who + ": " + key, "got ", [&] { return json_excerpt(of); },
                ", expected three numbers");
            for (std::size_t k = 0; k < 3; ++k) {
                v[static_cast<Index>(k)] = json_number(of[k], who + ": " + key);
                require(
                    std::abs(v[static_cast<Index>(k)]) <= most, who + ": " + key, "got ",
                    [&] { return json_excerpt(of); }, ", expected numbers of at most ", most);
            }
            return v;
        };
        const bool placed = light.is_object() && light.contains("position");
        require(!placed || !light.contains("to"), who,
                "has both to and position, expected one of them");
        const Vec3<double> at = vector(placed ? "position" : "to", most_length);
        require(at.norm() > 1 / most_length, who + (placed ? ": position" : ": to"),
                "got a vector of length 0");
        require(light.contains("width"), who + ": width", "is missing, expected radians");
        const double width = json_number(light.at("width"), who + ": width");
        require(width >= least_width && width <= most_width, who + ": width", "got ", width,
                " rad, expected ", least_width, " to ", most_width);
        all.lights.push_back({normalized(at), vector("intensity", most_intensity), width});
        if (placed) all.lights.back().position = at;
    }
    return all;
}

} // namespace rye::trainer
