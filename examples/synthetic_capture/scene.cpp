// SPDX-License-Identifier: Apache-2.0
#include "synthetic_capture/scene.hpp"

#include <algorithm>
#include <cmath>

#include <rye/core/error.hpp>
#include <rye/core/random.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

#include "data/degrees.hpp"

namespace rye::trainer {
namespace {

/// Directions of the cameras, (yaw, pitch) [deg] from the head, the most informative first.
constexpr std::array<std::array<double, 2>, 18> rig{{{0, 1},
                                                     {-32, 3},
                                                     {32, 3},
                                                     {-12, 16},
                                                     {13, 17},
                                                     {1, -29},
                                                     {3, 43},
                                                     {-69, 2},
                                                     {69, -2},
                                                     {11, -13},
                                                     {-10, -15},
                                                     {-26, 34},
                                                     {31, 33},
                                                     {-27, -28},
                                                     {25, -25},
                                                     {-53, 25},
                                                     {50, 17},
                                                     {-48, -13}}};
constexpr double rig_distance = 10.2;
/// Focal length times image width over distance, at which the head fills the image.
constexpr double focal_share = 0.3555;

/// Reach of the fixations [deg] and their distance from the eyes.
constexpr double most_eye_translation_mm = 5; // a third of an eyeball's radius here
constexpr double reach_yaw_deg = 30, reach_pitch_deg = 22, target_distance = 7.6;
/// Bounds of gazes that are asked for [deg], and their largest number.
constexpr double most_yaw_deg = 55, most_pitch_deg = 45;
constexpr std::size_t most_gazes = 100;

/// Typical kappa: angles between the optical axis and the line of sight.
const std::array<Vec2<double>, 2> kappas{Vec2<double>(5, -1.5), Vec2<double>(-5, -1.5)};

const std::vector<GazeCell> cells{
    {{-30, -16}, {8, 22}}, {{16, 30}, {-22, -8}}, {{-8, 8}, {12, 22}}, {{16, 30}, {4, 16}}};

/// Radical inverse of i: low-discrepancy points in (0, 1).
double halton(int i, int base) {
    double x = 0, part = 1.0 / base;
    for (; i > 0; i /= base, part /= base) x += part * (i % base);
    return x;
}

Vec3<double> direction(const Vec2<double>& deg) {
    return gaze_vector(deg.y() * degree, deg.x() * degree);
}
Vec2<double> yaw_pitch_deg(const Vec3<double>& v) {
    const Vec2<double> py = pitch_yaw(v);
    return Vec2<double>(py[1], py[0]) / degree;
}

std::string digits(int i, int width) {
    std::string text = std::to_string(i);
    return std::string(static_cast<std::size_t>(std::max(0, width - static_cast<int>(text.size()))),
                       '0') +
           text;
}

std::vector<SceneCamera> make_cameras(const CaptureSettings& s) {
    std::vector<SceneCamera> cameras;
    for (int i = 0; i < s.cameras; ++i) {
        const Random r = Random{s.seed, 101}.fork(static_cast<std::uint64_t>(i));
        const auto spread = [&](std::uint64_t k, double reach) {
            return reach * (2 * r.uniform(k) - 1);
        };
        SceneCamera c;
        c.yaw_deg = rig[static_cast<std::size_t>(i)][0] + spread(0, 1.5);
        c.pitch_deg = rig[static_cast<std::size_t>(i)][1] + spread(1, 1.5);
        c.distance = rig_distance + spread(2, 0.4);
        const Vec3<double> eye = head_centre + c.distance * direction({c.yaw_deg, c.pitch_deg});
        const double roll = spread(3, 0.04);
        const Vec3<double> up(std::sin(roll), std::cos(roll), 0);
        c.camera = look_at<double>(eye, head_centre, up, 1.0, {s.size, s.size});
        c.camera.fx = c.camera.fy = focal_share * s.size * c.distance * (1 + spread(4, 0.012));
        c.camera.cx += s.size / 256.0 * spread(5, 3);
        c.camera.cy += s.size / 256.0 * spread(6, 3);
        cameras.push_back(c);
    }
    std::sort(cameras.begin(), cameras.end(),
              [](const SceneCamera& a, const SceneCamera& b) { return a.yaw_deg < b.yaw_deg; });
    for (std::size_t i = 0; i < cameras.size(); ++i) cameras[i].id = digits(static_cast<int>(i), 2);
    return cameras;
}

/// Largest weight that is plausible in combination with others.
double limit(const std::string& name) {
    if (name.starts_with("eyeBlink")) return 0.25; // closed eyes show no gaze
    if (name == "jawOpen") return 0.60;
    if (name == "mouthFunnel" || name == "mouthPucker") return 0.70;
    if (name.starts_with("jaw")) return 0.60;
    return 0.85;
}

void set_pose(SceneFrame& f, const Random& r) {
    constexpr std::array<double, 6> reach{0.17, 0.26, 0.11, 0.09, 0.08, 0.08};
    for (int i = 0; i < 6; ++i)
        f.pose[i] = reach[static_cast<std::size_t>(i)] *
                    (2 * r.uniform(200 + static_cast<std::uint64_t>(i)) - 1);
}

/// Displaces the eyeballs by expression and head pose: smooth functions of both, 0 at rest and below
/// the bound. The expression's displacements of the two eyes mirror each other; the pose's are the
/// same, as gravity's would be.
void displace_eyes(SceneFrame& f, const CaptureSettings& s) {
    if (s.eye_translation_mm == 0) return;
    const Random random{s.seed, 107};
    const auto towards = [&](std::uint64_t k) {
        const Random r = random.fork(k);
        return normalized(Vec3<double>(r.normal(0), r.normal(1), r.normal(2)));
    };
    Vec3<double> by_expression = Vec3<double>::Zero(), by_pose = by_expression;
    for (Index k = 0; k < f.state.expression.size(); ++k)
        by_expression +=
            0.8 * f.state.expression[k] * towards(static_cast<std::uint64_t>(100 + k));
    for (int k = 0; k < 3; ++k)
        by_pose += 8 * f.pose[k] * towards(static_cast<std::uint64_t>(k));
    for (std::size_t e = 0; e < 2; ++e) {
        const Vec3<double> mirror(e == 0 ? 1 : -1, 1, 1);
        const Vec3<double> sum = mirror.cwiseProduct(by_expression) + by_pose;
        f.state.eye_offset[e] =
            s.eye_translation_mm * unit_per_mm / std::sqrt(1 + sum.squaredNorm()) * sum;
    }
}

/// The centre of an eyeball in this frame, head frame.
Vec3<double> centre_of(const SceneFrame& f, const HeadModel& model, std::size_t eye) {
    return model.eyes[eye].centre + f.state.eye_offset[eye];
}

/// Turns the eyes to the angles of the frame, with the lids that follow them.
void turn_eyes(SceneFrame& f) {
    for (std::size_t e = 0; e < 2; ++e) f.state.optical[e] = direction(f.optical_deg[e]);
    f.state.lids = lid_coefficients(f.optical_deg);
}

/// Independent random gazes of both eyes.
void look_apart(SceneFrame& f, int index, const CaptureScene& scene, const Random& r) {
    constexpr std::array<std::array<double, 4>, 2> first{
        {{19, -7.5, -21, 3.5}, {-15, 10.5, 5, -13.5}}};
    for (std::size_t e = 0; e < 2; ++e) {
        f.optical_deg[e] =
            index < 2 ? Vec2<double>(first[static_cast<std::size_t>(index)][2 * e],
                                     first[static_cast<std::size_t>(index)][2 * e + 1])
                      : Vec2<double>(40 * r.uniform(300 + e) - 20, 28 * r.uniform(310 + e) - 14);
        f.visual[e] = direction(f.optical_deg[e] - scene.kappa_deg[e]);
    }
    turn_eyes(f);
}

} // namespace

VecX<double> random_expression(const std::vector<std::string>& names, const Random& r) {
    std::vector<std::string> groups;
    const auto group = [](const std::string& name) {
        const bool sided = name.ends_with("_L") || name.ends_with("_R");
        return sided ? name.substr(0, name.size() - 2) : name;
    };
    for (const std::string& name : names)
        if (groups.empty() || std::find(groups.begin(), groups.end(), group(name)) == groups.end())
            groups.push_back(group(name));
    VecX<double> weights = VecX<double>::Zero(static_cast<Index>(names.size()));
    const Index chosen = 2 + r.below(0, 4);
    for (Index k = 0; k < chosen && !groups.empty(); ++k) {
        const auto key = static_cast<std::uint64_t>(10 * (k + 1));
        const auto pick = static_cast<std::size_t>(r.below(key, static_cast<Index>(groups.size())));
        const double strength = 0.2 + 0.8 * r.uniform(key + 1);
        for (std::size_t i = 0; i < names.size(); ++i) {
            if (group(names[i]) != groups[pick]) continue;
            const double apart = names[i].ends_with("_R") ? 0.3 * (r.uniform(key + 2) - 0.5) : 0.0;
            weights[static_cast<Index>(i)] =
                std::clamp(strength * (1 + apart), 0.0, 1.0) * limit(names[i]);
        }
    }
    return weights;
}

void look_at_target(SceneFrame& f, const HeadModel& model, const CaptureScene& scene,
                    const Vec3<double>& target) {
    f.target = f.state.world_from_head.apply(target);
    for (std::size_t e = 0; e < 2; ++e) {
        f.visual[e] = normalized(Vec3<double>(target - centre_of(f, model, e)));
        f.optical_deg[e] = yaw_pitch_deg(f.visual[e]) + scene.kappa_deg[e];
    }
    turn_eyes(f);
}

void place_eyes(SceneFrame& f, const HeadModel& model, const CaptureScene& scene) {
    const Vec3<double> between = 0.5 * (model.eyes[0].centre + model.eyes[1].centre);
    look_at_target(f, model, scene, between + target_distance * direction(*f.fixation_deg));
}

CaptureScene capture_scene(const HeadModel& model, const CaptureSettings& s) {
    const auto check = [](const char* name, int value, int low, int high) {
        require(
            value >= low && value <= high, "capture", "got ", [&] { return std::to_string(value); },
            " for ", name, ", expected ", [&] { return std::to_string(low); }, " to ",
            [&] { return std::to_string(high); });
    };
    check("the image size", s.size, 32, 4096);
    require(s.size % 2 == 0, "capture", "image size ", s.size,
            " is odd, but half-size images need an even one");
    check("the cameras", s.cameras, 1, static_cast<int>(rig.size()));
    check("the training frames", s.train_frames, 1, 9000);
    check("the test frames", s.novel_frames, 0, 900);
    check("the frames with eyes apart", s.independent_frames, 0, 90);
    check("the samples", s.samples, 1, 1024);
    require(
        s.eye_translation_mm >= 0 && s.eye_translation_mm <= most_eye_translation_mm, "capture",
        "got ", [&] { return std::to_string(s.eye_translation_mm); },
        " for the eye translation [mm], "
        "expected 0 to ",
        [&] { return std::to_string(most_eye_translation_mm); });

    require(s.gazes.size() <= most_gazes, "capture", "got ", s.gazes.size(),
            " gazes, expected at most ", most_gazes);
    for (const Vec2<double>& g : s.gazes)
        require(std::abs(g.x()) <= most_yaw_deg && std::abs(g.y()) <= most_pitch_deg, "capture",
                "got ", g.x(), ",", g.y(), " for a gaze's yaw and pitch [deg], expected at most ",
                most_yaw_deg, " and ", most_pitch_deg, " to either side");

    CaptureScene scene{s, make_cameras(s), {}, kappas, cells};
    const int total = s.train_frames + s.novel_frames + s.independent_frames;
    int drawn = 0;
    for (int i = 0; i < total; ++i) {
        const Random r = Random{s.seed, 103}.fork(static_cast<std::uint64_t>(i));
        SceneFrame f;
        f.id = digits(i, 4);
        f.kind = i < s.train_frames                    ? FrameKind::train
                 : i < s.train_frames + s.novel_frames ? FrameKind::novel
                                                       : FrameKind::independent;
        f.state.expression = VecX<double>::Zero(static_cast<Index>(model.expression_names.size()));
        if (s.softboxes) f.state.softboxes = *s.softboxes;
        f.state.corneal_index = s.corneal_index();
        if (i > 0) {
            set_pose(f, r);
            f.state.expression = random_expression(model.expression_names, r);
        }
        displace_eyes(f, s);
        f.state.world_from_head = {so3_exp(Vec3<double>(f.pose.head<3>())), f.pose.tail<3>()};
        if (f.kind == FrameKind::train) {
            Vec2<double> at(0, 0);
            const auto held_out = [&](const GazeCell& c) { return c.contains(at); };
            while (i > 0) {
                ++drawn;
                at = {reach_yaw_deg * (2 * halton(drawn, 2) - 1),
                      reach_pitch_deg * (2 * halton(drawn, 3) - 1)};
                if (std::none_of(cells.begin(), cells.end(), held_out)) break;
            }
            f.fixation_deg = at;
        } else if (f.kind == FrameKind::novel) {
            const GazeCell& c = cells[static_cast<std::size_t>(i - s.train_frames) % cells.size()];
            f.fixation_deg = Vec2<double>(
                std::lerp(c.yaw_deg[0], c.yaw_deg[1], 0.15 + 0.7 * r.uniform(320)),
                std::lerp(c.pitch_deg[0], c.pitch_deg[1], 0.15 + 0.7 * r.uniform(321)));
        }
        if (f.fixation_deg)
            place_eyes(f, model, scene);
        else
            look_apart(f, i - s.train_frames - s.novel_frames, scene, r);
        scene.frames.push_back(f);
    }
    for (const Vec2<double>& gaze : s.gazes) {
        SceneFrame f;
        f.id = digits(static_cast<int>(scene.frames.size()), 4);
        f.kind = FrameKind::novel;
        f.state.expression = VecX<double>::Zero(static_cast<Index>(model.expression_names.size()));
        if (s.softboxes) f.state.softboxes = *s.softboxes;
        f.state.corneal_index = s.corneal_index();
        f.state.world_from_head = {Mat3<double>::Identity(), Vec3<double>::Zero()};
        f.fixation_deg = gaze;
        place_eyes(f, model, scene);
        scene.frames.push_back(f);
    }
    return scene;
}

} // namespace rye::trainer
