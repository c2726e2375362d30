// SPDX-License-Identifier: Apache-2.0
#include "commands/info_effects.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <iterator>

#include <rye/io/splats.hpp>
#include <rye/gaussian/activate.hpp>
#include <rye/math/rotation.hpp>

#include "commands/options.hpp"
#include "data/json_fields.hpp"
#include "data/memory_limit.hpp"
#include "data/photographs.hpp"
#include "data/zstd.hpp"
#include "drawing/dispatch.hpp"
#include "drawing/scene_profile.hpp"
#include "drawing/shown.hpp"
#include "drawing/variants.hpp"

namespace rye::trainer {
namespace {

std::string number(double x) {
    char text[32];
    std::snprintf(text, sizeof text, "%.2g", x);
    return text;
}

/// Parts of the answer.
struct Explanation {
    std::string scene; ///< what was examined, without label and line end
    SceneProfile profile;
    std::string checks; ///< further lines
};

std::string explain(const SceneProfile& p) {
    std::string out = "effects that are called for, so that no colour changes by more than " +
                      number(p.bound) + ":\n";
    for (const Finding& f : p.findings) {
        const std::string name(name_of(f.effect));
        out += std::string(f.called ? "  yes  " : "  no   ") + name +
               std::string(20 - std::min<std::size_t>(19, name.size()), ' ') + f.reason + "\n";
    }
    return out;
}

/// Adds facts of the scene from a render of these Gaussians.
void add_splats(const Gaussians<float>& g, const Pinhole<float>& camera, double pixel,
                RenderFacts& facts) {
    const TrainRasterizer rasterizer = train_rasterizer();
    RasterScratch<float> scratch;
    rasterizer.project_into(train_backend(), g, camera, scratch);
    facts.dilation = rasterizer.accuracy.dilation;
    for (std::size_t i = 0; i < scratch.state.size(); ++i) {
        if (scratch.state[i] != Visibility::visible) continue;
        const Footprint<float>& f = scratch.footprints[i];
        const double xx = f.covariance.xx - facts.dilation, yy = f.covariance.yy - facts.dilation;
        const double xy = f.covariance.xy, middle = 0.5 * (xx + yy);
        const double spread = std::sqrt(std::max(0.0, 0.25 * (xx - yy) * (xx - yy) + xy * xy));
        // Without width, only the rounding of the dilated variances is left.
        const double narrow = std::sqrt(std::max(1e-6, middle - spread));
        ++facts.splats;
        facts.below_a_pixel += narrow < pixel ? 1 : 0;
        facts.narrowest = std::min(facts.narrowest, narrow);
    }
}

// ---- Gaussians of a file ------------------------------------------------------------------------

/// Rendering options of a cloud: degree of harmonics, with dilation or without.
template <int Degree, bool Antialias>
struct SplatVariant {
    static constexpr EffectMask effects = [] {
        EffectMask m;
        if (Degree >= 1) m.add(EffectName::sh1);
        if (Degree >= 2) m.add(EffectName::sh2);
        if (Degree >= 3) m.add(EffectName::sh3);
        if (Antialias) m.add(EffectName::antialias);
        return m;
    }();

    static Image<float> draw(const GaussianCloud<float>& cloud, const Pinhole<float>& camera) {
        TrainRasterizer rasterizer = train_rasterizer();
        if (!Antialias) rasterizer.accuracy.dilation = 0;
        const GaussianCloud<float> used = Degree >= 3 ? cloud : truncated(cloud, Degree);
        const VecX<float> black = VecX<float>::Zero(3);
        return rasterizer
            .forward(train_backend(), activate(used, Vec3<float>(camera.centre())), camera, black)
            .feature;
    }
};
using AllOfSplats = SplatVariant<3, true>;
using SplatVariants =
    Variants<SplatVariant<0, false>, SplatVariant<0, true>, SplatVariant<1, false>,
             SplatVariant<1, true>, SplatVariant<2, false>, SplatVariant<2, true>,
             SplatVariant<3, false>, AllOfSplats>;

/// Returns a camera along the cloud's third axis with nearly all Gaussians in view.
Pinhole<float> view_of(const GaussianCloud<float>& cloud) {
    Vec3<float> middle, reach;
    for (Index k = 0; k < 3; ++k) {
        std::vector<float> x;
        for (Index i = 0; i < cloud.count(); ++i)
            if (std::isfinite(cloud.mean(k, i))) x.push_back(cloud.mean(k, i));
        std::sort(x.begin(), x.end());
        require(!x.empty(), "rye info", "no Gaussian has a finite mean");
        const float low = x[x.size() / 50], high = x[x.size() - 1 - x.size() / 50];
        middle[k] = 0.5f * (low + high);
        reach[k] = 0.5f * (high - low);
    }
    const float size = std::max({reach[0], reach[1], reach[2], 1e-3f});
    Pinhole<float> camera = look_at<float>(middle - Vec3<float>(0, 0, 4 * size), middle,
                                           Vec3<float>(0, -1, 0), 0.6f, {512, 512});
    camera.near_depth = 0.01f * size;
    return camera;
}

Explanation explain_splats(const EffectsOptions& o, const ProfileBounds& bounds) {
    const GaussianCloud<float> cloud = read_splats<float>(o.scene, memory_limit(), zstd_decompressor());
    const Pinhole<float> camera = view_of(cloud);
    SceneFacts facts;
    add_sh(cloud, facts);
    RenderFacts render;
    render.size = render.wanted = {double(camera.width), double(camera.height)};
    add_splats(activate(cloud, Vec3<float>(camera.centre())), camera, bounds.pixel, render);
    facts.render = render;
    const SceneProfile p = profile(facts, bounds);
    const std::string scene = std::to_string(cloud.count()) +
                              " Gaussians of a file, harmonics of degree " +
                              std::to_string(cloud.degree()) + ", seen in 512 x 512 px";
    std::string out;
    const Image<float> all = AllOfSplats::draw(cloud, camera);
    dispatch(SplatVariants(), p.effects, [&]<class V>(V) {
        const Image<float> chosen = V::draw(cloud, camera);
        const float worst = (all.pixels - chosen.pixels).cwiseAbs().maxCoeff();
        out += "variant        " + text_of(V::effects) + "; of " +
               std::to_string(SplatVariants::count) + " that are compiled the smallest with them\n" +
               "check          its picture differs from that of all effects by at most " +
               number(static_cast<double>(worst)) +
               (worst <= bounds.color ? ", within the bound\n" : ", NOT within the bound\n");
    });
    return {scene, p, out};
}

// ---- photographs --------------------------------------------------------------------------------

Explanation explain_photographs(const std::filesystem::path& folder, const ProfileBounds& bounds) {
    const std::filesystem::path path = folder / "transforms.json";
    SceneFacts facts;
    RenderFacts render;
    const nlohmann::json json = read_json(path);
    const auto of = [&](const char* key) { return json_number(json, key, 0, path.string()); };
    const std::size_t frames =
        json_list(json, "frames", path.string(), "a list of photographs").size();
    render.size = render.wanted = {of("w"), of("h")};
    render.distortion = lens_coefficients(path);
    facts.render = render;
    const SceneProfile p = profile(facts, bounds);
    return {
        std::to_string(frames) + " photographs with cameras; no drivers: what is seen stands still",
        p,
        (p.effects.has(EffectName::lens_distortion)
             ? "               rye render --cameras draws through this lens, if it is OPENCV's\n"
             : "")};
}

// ---- captures -----------------------------------------------------------------------------------

DriverFacts driver_facts(const Capture& c, GazeAxis axis) {
    DriverFacts d;
    for (int f = 0; f < c.frame_count(); ++f) {
        const CaptureFrame& frame = c.frames[static_cast<std::size_t>(f)];
        d.add({frame.expression.begin(), frame.expression.end()}, frame.pose, frame.scale);
        if (!frame.has_gaze) continue;
        for (std::size_t e = 0; e < 2; ++e) {
            const CaptureEye& eye = frame.eyes[e];
            d.add_gaze(e, gaze_of(eye, axis));
            if (!c.has_eye_masks) continue;
            for (int k = 0; k < c.camera_count(); ++k) {
                if (!c.view(f, k).present) continue;
                if (!(c.eye_mask(f, k).pixels.row(static_cast<Index>(e)).sum() > 0)) continue;
                ++d.eyes[e].views;
                if (!eye.centre || !eye.limbus_radius) continue;
                const Pinhole<double>& camera = c.camera(f, k);
                const double depth = camera.project_point(*eye.centre).z();
                d.eyes[e].iris =
                    std::max(d.eyes[e].iris, 2 * *eye.limbus_radius * camera.fx / depth);
                const Vec3<double> forward =
                    gaze_in_world(so3_exp(Vec3<double>(frame.pose.head<3>())), eye.optical);
                d.eyes[e].aside =
                    std::max(d.eyes[e].aside,
                             angular_error(forward, Vec3<double>(camera.centre() - *eye.centre)));
            }
        }
    }
    return d;
}

/// Returns frames spread over a capture.
std::vector<int> some_frames(const Capture& c, int most) {
    std::vector<int> frames;
    const int n = std::min(most, c.frame_count());
    for (int k = 0; k < n; ++k) frames.push_back(k * c.frame_count() / n);
    return frames;
}

/// Compares renders of some frames by the chosen variant with those of all effects.
std::string check_avatar(const TrainState& state, const Capture& c, const EffectsOptions& o,
                         double bound) {
    std::vector<DrawnFrame> shown;
    for (const int f : some_frames(c, 6))
        shown.push_back({frame_drivers(c, f, state.config.gaze_axis),
                         c.camera(f, camera_index(c, "", f)).cast<float>()});
    const FrameDrawer drawer(state, shown, o.variant, "--effects", bound);
    float worst = 0;
    for (const DrawnFrame& f : shown)
        worst = std::max(worst, (drawer.picture_by_all(f).pixels - drawer.picture(f).pixels)
                                    .cwiseAbs().maxCoeff());
    return "pictures of " + std::to_string(shown.size()) + " frames, each from its front:\n" +
           drawer.explanation() +
           "check          they differ from those of all effects by at most " +
           number(double(worst)) +
           (worst <= bound ? ", within the bound\n" : ", NOT within the bound\n");
}

Explanation explain_capture(const EffectsOptions& o, const ProfileBounds& bounds) {
    std::optional<TrainState> state;
    if (!o.run.empty()) state = load_trained(o.run);
    const Capture c =
        read_capture(o.scene.empty() ? capture_folder(o.run, *state, {}, "counting the effects")
                                     : std::filesystem::path(o.scene));
    require(c.frame_count() > 0, "rye info", "the capture has no frames");
    SceneFacts facts;
    if (state) require_same_subject(*state, c);
    facts.drivers = driver_facts(c, state ? state->config.gaze_axis : GazeAxis::optical);
    if (state && state->avatar.eyes.kappa.size() > 0)
        facts.drivers->kappa =
            static_cast<double>(state->avatar.eyes.kappa.colwise().norm().maxCoeff());
    if (state) facts.drivers->lights = static_cast<int>(state->avatar.eyes.optics.lights());
    RenderFacts render;
    render.size = render.wanted = {double(c.width), double(c.height)};
    if (state) {
        std::vector<Drivers<float>> all;
        for (int f = 0; f < c.frame_count(); ++f) all.push_back(frame_drivers(c, f, state->config.gaze_axis));
        facts.avatar = avatar_facts(*state, all, false);
        const int factor = 1 << state->config.gaussians.upsampler.doublings;
        for (double& side : render.size) side /= factor;
        const int f = frame_index(c, "");
        add_splats(driven_gaussians(*state, frame_drivers(c, f, state->config.gaze_axis)),
                   reduced(c.camera(f, camera_index(c, "", f)).cast<float>(), factor),
                   bounds.pixel, render);
    }
    facts.render = render;
    const SceneProfile p = profile(facts, bounds);
    const std::string scene = "a head in " + std::to_string(c.frame_count()) + " frames and " +
                              std::to_string(c.camera_count()) + " cameras" +
                              (state ? ", and the avatar that was trained of it"
                                     : "; no run was given, so only the capture is judged");
    return {scene, p, state ? check_avatar(*state, c, o, p.bound) : ""};
}

Explanation explained(const EffectsOptions& o) {
    ProfileBounds bounds;
    bounds.color = parsed_error(o.bound, "--bound");
    const std::filesystem::path scene = o.scene;
    require(!o.scene.empty() || !o.run.empty(), "rye info",
            "--effects: neither a scene nor --run is given");
    if (!std::filesystem::is_directory(scene) && !o.scene.empty()) return explain_splats(o, bounds);
    if (o.run.empty() && std::filesystem::exists(scene / "transforms.json") &&
        !std::filesystem::exists(scene / "params"))
        return explain_photographs(scene, bounds);
    return explain_capture(o, bounds);
}

} // namespace

std::string explain_effects(const EffectsOptions& o) {
    const Explanation e = explained(o);
    return "scene          " + e.scene + "\n" + explain(e.profile) + e.checks;
}

nlohmann::ordered_json effects_json(const EffectsOptions& o) {
    using Json = nlohmann::ordered_json;
    const Explanation e = explained(o);
    Json effects = Json::array();
    for (const Finding& f : e.profile.findings)
        effects.push_back({{"effect", std::string(name_of(f.effect))},
                           {"called", f.called},
                           {"reason", f.reason}});
    return {
        {"scene", e.scene}, {"bound", e.profile.bound}, {"effects", effects}, {"checks", e.checks}};
}

} // namespace rye::trainer
