// SPDX-License-Identifier: Apache-2.0
/// drawing/scene_profile.hpp: the effects that a scene needs, and the reasons. Facts counted from
/// its data describe the scene; unknown facts are empty and require nothing. Lengths in canonical
/// head units, angles [rad], colours in 0..1. Leaving out the other effects changes no colour by
/// more than the bound:
///   spherical harmonics  |sum_m b_m c_m| <= sqrt((2l + 1) / 4 pi) |c| of band l and a channel; a
///                        pixel's weights add up to at most 1, and max(0, .) does not stretch
///   antialias            a splat thinner than a pixel calls for it; a dilation of d px^2 changes
///                        the opacity of one of variance s [px^2] by 2 d / (2.718 s) or less
///   all others           their inputs vary by less than their own bound
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include <rye/core/columns.hpp>
#include <rye/gaussian/cloud.hpp>
#include <rye/rig/effect_names.hpp>
#include <rye/rig/gaze.hpp>

namespace rye::trainer {

/// Range of some numbers over frames; the widest of several that are added together.
struct Ranges {
    std::vector<double> low, high;

    template <class Numbers>
    void add(const Numbers& x) {
        const auto n = static_cast<std::size_t>(x.size());
        if (low.empty()) {
            low.assign(n, INFINITY);
            high.assign(n, -INFINITY);
        }
        for (std::size_t k = 0; k < std::min(n, low.size()); ++k) {
            const double v = static_cast<double>(x[static_cast<Index>(k)]);
            low[k] = std::min(low[k], v);
            high[k] = std::max(high[k], v);
        }
    }
    /// Returns the index of the number with the widest range.
    std::size_t widest() const {
        std::size_t best = 0;
        for (std::size_t k = 1; k < low.size(); ++k)
            if (high[k] - low[k] > high[best] - low[best]) best = k;
        return best;
    }
    double width() const { return low.empty() ? 0 : high[widest()] - low[widest()]; }
    /// Returns the largest absolute value.
    double greatest() const {
        double r = 0;
        for (std::size_t k = 0; k < low.size(); ++k)
            r = std::max({r, std::abs(low[k]), std::abs(high[k])});
        return r;
    }
};

/// Facts about one eye in the frames of a capture.
struct EyeFacts {
    double turn = 0;             ///< largest angle between a gaze and the eye at rest [rad]
    double iris = 0;             ///< largest width in a view that sees it [px]; 0: never seen
    Index views = 0;             ///< number that see it
    double aside = 0;            ///< largest angle of such a view from the optical axis [rad]
};

/// Facts about the drivers of a capture's frames.
struct DriverFacts {
    Index frames = 0;
    Ranges expression, pose, scale;
    double identity = 0;         ///< largest change by a pose: |pose|, |scale - 1|
    std::array<EyeFacts, 2> eyes;
    std::array<Ranges, 2> gaze;  ///< (pitch, yaw) [rad]
    Ranges pupil;                ///< radii over those at rest
    /// Direction of eyes that do not turn: straight ahead, or as an avatar is held.
    std::array<Vec3<double>, 2> rest{Vec3<double>::UnitZ(), Vec3<double>::UnitZ()};
    double kappa = 0;            ///< largest angle yet to be added to a gaze [rad]
    int lights = 0;              ///< number with known positions

    void add(const std::vector<double>& code, const Vec<double, 6>& p, double s) {
        ++frames;
        const auto n = static_cast<Index>(code.size());
        expression.add(Eigen::Map<const VecX<double>>(code.data(), n));
        pose.add(p);
        scale.add(Vec<double, 1>(s));
        identity = std::max({identity, p.cwiseAbs().maxCoeff(), std::abs(s - 1)});
    }
    void add_gaze(std::size_t eye, const Vec3<double>& g) {
        gaze[eye].add(pitch_yaw(g));
        eyes[eye].turn = std::max(eyes[eye].turn, angular_error(g, rest[eye]));
    }
};

/// Facts about a trained avatar.
struct AvatarFacts {
    Index moved_by_expression = 0, moved_by_pose = 0;  ///< points of the face
    std::array<Index, 2> moved_by_gaze{};
    double eye_offset = 0;       ///< largest motion of a centre from its rest in any frame [unit]
    int channels = 3;
    bool refines = false;        ///< true if super-resolution changes the picture
    bool corneas = false;        ///< true if irises lie behind corneas
    bool shaded = false;         ///< true if colours depend on the head's rotation
    double view_color = 0;       ///< a bound on how far colours change with the view; 0: none
    bool lid_shadow = false;     ///< true if its lids cast shadows on the eyes
    bool driven_eyes = false;    ///< true if networks give its eyes' features
};

/// Facts about a drawing: splats on the screen, and the sizes of pictures.
struct RenderFacts {
    std::array<double, 2> size{};         ///< of the render [px]
    std::array<double, 2> wanted{};       ///< of the picture [px]
    Index splats = 0;                     ///< number seen
    Index below_a_pixel = 0;              ///< of these, with the smaller deviation below a pixel
    double narrowest = INFINITY;          ///< smallest deviation [px]
    double dilation = 0.3;                ///< dilation that would be left out [px^2]
    std::vector<double> distortion;       ///< coefficients of the lens
    std::string extra;                    ///< other images asked for
};

struct SceneFacts {
    std::optional<DriverFacts> drivers;
    std::optional<AvatarFacts> avatar;
    std::optional<RenderFacts> render;
    /// Largest change of a colour without band 1, band 2, or bands from 3 on.
    std::optional<std::array<double, 3>> sh;
    std::array<double, 3> sh_rest{};  ///< without a band and all above it
};

/// Computes the largest change of a colour without spherical harmonics, over all Gaussians.
template <class T>
void add_sh(const GaussianCloud<T>& cloud, SceneFacts& facts) {
    std::array<double, 3> alone{}, rest{};
    const Index per_channel = cloud.sh_rest.rows() / 3;
    for (Index i = 0; i < cloud.count(); ++i)
        for (Index c = 0; c < 3; ++c) {
            double above = 0;
            for (int l = cloud.degree(); l >= 1; --l) {
                const Index from = c * per_channel + l * l - 1;
                const double norm = static_cast<double>(
                    cloud.sh_rest.col(i).segment(from, 2 * l + 1).template cast<double>().norm());
                const double most = std::sqrt((2 * l + 1) / (4 * std::numbers::pi)) * norm;
                above += most;
                const auto at = static_cast<std::size_t>(std::min(l, 3) - 1);  // 4 as 3
                alone[at] = std::max(alone[at], most);
                rest[at] = std::max(rest[at], above);
            }
        }
    facts.sh = alone;
    facts.sh_rest = rest;
}

/// Decision about one effect, and the reason in plain words.
struct Finding {
    EffectName effect;
    bool called = false;
    std::string reason;
};

struct SceneProfile {
    double bound = 0;
    EffectMask effects;
    std::vector<Finding> findings;       ///< one for every effect
};

/// Smallest changes that count.
struct ProfileBounds {
    double color = 1.0 / 255;            ///< of a picture's colours
    double coefficient = 1e-3;           ///< of an expression, and of a pose for the residual
    double move = 1e-4;                  ///< of a Gaussian [unit]: 1/20 px of a head 1000 px high
    double eye_radius = 0.12;            ///< radius that turns an eye's rotation into a motion
    double pupil = 0.02;                 ///< its radius at rest [unit]
    double gaze = 1e-3;                  ///< for the skin around the eye [rad]
    double bulge = 20;                   ///< iris above which the cornea's shape is visible [px]
    double glint = 12;                   ///< ... a light's mirror image is visible [px]
    double refraction = 60;              ///< ... refraction by the cornea is visible [px]
    double grazing = 1.0471975511965976; ///< angle of a view that always shows refraction [rad]
    double pixel = 1;                    ///< deviation of a splat below which it is too thin [px]
};

namespace detail {

inline std::string plain(double x) {
    char text[32];
    std::snprintf(text, sizeof text, std::abs(x) >= 100 ? "%.0f" : "%.3g", x);
    return text;
}

} // namespace detail

/// Returns the effects that the scene needs, with the reasons.
inline SceneProfile profile(const SceneFacts& scene, const ProfileBounds& b) {
    using detail::plain;
    SceneProfile p;
    p.bound = b.color;
    const auto say = [&](EffectName e, bool called, const std::string& reason) {
        p.findings.push_back({e, called, reason});
        if (called) p.effects.add(e);
    };
    const auto compare = [&](EffectName e, double value, double most, const std::string& what) {
        say(e, value > most,
            what + " " + plain(value) + (value > most ? ", more than " : ", at most ") +
                plain(most));
    };

    using enum EffectName;
    const bool drivers = scene.drivers.has_value(), avatar = scene.avatar.has_value();
    const DriverFacts d = scene.drivers.value_or(DriverFacts{});
    const AvatarFacts a = scene.avatar.value_or(AvatarFacts{});
    const std::string over = " over " + std::to_string(d.frames) + " frames by";
    const bool expression_varies = d.expression.width() > b.coefficient;
    const bool pose_varies = d.pose.width() > b.coefficient || d.scale.width() > b.move;
    if (!drivers)
        for (const EffectName e :
             {expression, head_pose, pose_residual, left_gaze, right_gaze, eye_offset, kappa,
              periocular, corneal_bulge, corneal_refraction, glint, pupil, lid_shadow, head_shading,
              view_color, eye_appearance})
            say(e, false, "nothing here is driven");
    else {
        if (expression_varies && avatar && a.moved_by_expression == 0)
            say(expression, false, "it varies, but moves no point of the avatar");
        else
            compare(expression, d.expression.width(), b.coefficient,
                    "coefficient " + std::to_string(d.expression.widest()) + " varies" + over);
        compare(head_pose, d.identity, b.move, "a pose is away from none by");
        if (pose_varies && avatar && a.moved_by_pose == 0)
            say(pose_residual, false, "the pose varies, but moves no point of the avatar");
        else
            compare(pose_residual, d.pose.width(), b.coefficient, "the pose varies" + over);
        for (std::size_t e = 0; e < 2; ++e) {
            const EffectName turns = e == 0 ? left_gaze : right_gaze;
            const EyeFacts& eye = d.eyes[e];
            if (eye.views == 0)
                say(turns, false, "no view sees this eye");
            else
                compare(turns, eye.turn, b.move / b.eye_radius,
                        "seen in " + std::to_string(eye.views) + " views; turned from " +
                            (d.rest[e] == Vec3<double>::UnitZ() ? "straight ahead"
                                                                : "where it is held") +
                            " by [rad]");
        }
        if (avatar)
            compare(eye_offset, a.eye_offset, b.move, "the avatar moves an eye's centre by [unit]");
        else
            say(eye_offset, expression_varies || pose_varies,
                expression_varies || pose_varies ? "expression or pose vary, and may move the eyes"
                                                 : "neither expression nor pose vary");
        compare(kappa, d.kappa, b.move / b.eye_radius,
                "the gaze is the optical axis up to an angle of [rad]");
        const double turns = std::max(d.gaze[0].width(), d.gaze[1].width());
        const bool seen = d.eyes[0].views + d.eyes[1].views > 0;
        if (turns > b.gaze && !seen)
            say(periocular, false, "a gaze varies, but no view sees an eye");
        else if (turns > b.gaze && avatar && a.moved_by_gaze[0] + a.moved_by_gaze[1] == 0)
            say(periocular, false, "a gaze varies, but no skin of the avatar is near an eye");
        else
            compare(periocular, turns, b.gaze, "a gaze varies" + over + " [rad]");
        const double iris = std::max(d.eyes[0].iris, d.eyes[1].iris);
        const double aside = std::max(d.eyes[0].aside, d.eyes[1].aside);
        compare(corneal_bulge, iris, b.bulge, "the widest iris has, in px,");
        if (avatar && !a.corneas)
            say(corneal_refraction, false, "the avatar has no irises behind corneas");
        else if (aside > b.grazing)
            compare(corneal_refraction, aside, b.grazing, "an eye is seen from aside by [rad]");
        else
            compare(corneal_refraction, iris, b.refraction, "the widest iris has, in px,");
        if (d.lights == 0)
            say(glint, false, "no light's place is known");
        else
            compare(glint, iris, b.glint,
                    std::to_string(d.lights) + (d.lights == 1 ? " light" : " lights") +
                        "; the widest iris has, in px,");
        if (!seen && d.pupil.width() > 0)
            say(pupil, false, "it varies, but no view sees an eye");
        else
            compare(pupil, d.pupil.width(), b.move / b.pupil, "a pupil's ratio varies" + over);
        if (a.shaded)
            compare(head_shading, d.pose.width(), b.coefficient, "the pose varies" + over);
        else
            say(head_shading, false, "no light's change with the head is known");
        if (a.view_color > 0)
            compare(view_color, a.view_color, b.color, "with the view a colour changes by up to");
        else
            say(view_color, false, "colours are the same from everywhere");
        const double varies = std::max({turns, d.pose.width(), d.expression.width()});
        if (!a.lid_shadow)
            say(lid_shadow, false, "no shadow of the lids is known");
        else if (varies > b.coefficient && !seen)
            say(lid_shadow, false, "eyes or lids move, but no view sees an eye");
        else
            compare(lid_shadow, varies, b.coefficient, "gaze, head pose or expression vary" + over);
        if (!a.driven_eyes)
            say(eye_appearance, false, "the eyes' features are constants");
        else if (varies > b.coefficient && !seen)
            say(eye_appearance, false, "what it reads varies, but no view sees an eye");
        else
            compare(eye_appearance, varies, b.coefficient,
                    "gaze, head pose or expression vary" + over);
    }

    if (!scene.sh) {
        for (const EffectName e : {sh1, sh2, sh3})
            say(e, false, avatar ? "colours are features, the same from everywhere"
                                 : "there are no Gaussians with spherical harmonics yet");
    } else {
        for (std::size_t l = 0; l < 3; ++l) {
            const EffectName e = l == 0 ? sh1 : l == 1 ? sh2 : sh3;
            if ((*scene.sh)[l] == 0)
                say(e, scene.sh_rest[l] > b.color,
                    scene.sh_rest[l] > b.color ? "empty, but a band above it is called for"
                                               : "all coefficients are 0, or there are none");
            else
                compare(e, scene.sh_rest[l], b.color,
                        "without this band and those above it a colour changes by up to");
        }
    }

    if (avatar)
        say(feature_channels, a.channels > 3 && a.refines,
            std::to_string(a.channels) + " channels, " +
                (a.channels > 3 && a.refines ? "which super-resolution reads"
                                             : "of which a picture shows 3"));
    else
        say(feature_channels, false, "a picture has 3 channels");
    if (!scene.render) {
        say(antialias, false, "there is nothing to draw yet");
        say(lens_distortion, false, "no lens is described");
        say(super_resolution, avatar && a.refines, "");
        say(extra_outputs, false, "none was asked for");
        return p;
    }
    const RenderFacts& r = *scene.render;
    if (r.splats == 0) {
        say(antialias, false, "there is no Gaussian to draw yet");
    } else {
        const double shows = 2 * r.dilation / (std::numbers::e * r.narrowest * r.narrowest);
        const bool thin = r.below_a_pixel > 0;
        say(antialias, thin || shows > b.color,
            (thin ? std::to_string(r.below_a_pixel) + " of " + std::to_string(r.splats) +
                        " Gaussians in view are thinner than " + plain(b.pixel) + " px"
                  : "without it an opacity changes by up to " + plain(shows)) +
                "; the thinnest has a deviation of " + plain(r.narrowest) + " px");
    }
    double bent = 0;
    for (const double k : r.distortion) bent = std::max(bent, std::abs(k));
    say(lens_distortion, bent > 0,
        r.distortion.empty() ? "the cameras are pinholes"
                             : "the lens's coefficients are " +
                                   (bent > 0 ? "up to " + plain(bent) : std::string("all 0")));
    const bool larger = r.wanted[0] > r.size[0] || r.wanted[1] > r.size[1];
    const std::string sizes = "the picture has " + plain(r.wanted[0]) + " x " + plain(r.wanted[1]) +
                              " px, the render " + plain(r.size[0]) + " x " + plain(r.size[1]);
    say(super_resolution, larger || (avatar && a.refines),
        sizes + (!larger && avatar && a.refines ? ", but the avatar's network refines it" : ""));
    say(extra_outputs, !r.extra.empty(), r.extra.empty() ? "none was asked for" : r.extra);
    return p;
}

} // namespace rye::trainer
