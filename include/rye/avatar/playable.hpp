// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/playable.hpp: a trained avatar together with what a program needs to show it: its
/// settings, the drivers that it rests at, their ranges, a camera and a background.
/// Frames: canonical units, head frame with +z out of the face; eye 0 is the subject's left;
/// cameras as in geometry/camera.hpp. The file is io/avatar_file.hpp's.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <vector>

#include <rye/avatar/drawn_size.hpp>
#include <rye/avatar/trained.hpp>
#include <rye/core/error.hpp>
#include <rye/core/format.hpp>
#include <rye/geometry/check_camera.hpp>
#include <rye/math/linalg.hpp>
#include <rye/math/rotation.hpp>

namespace rye {

/// Ranges of drivers that the avatar was trained with: bounds of sliders, not of drive().
template <class T>
struct DriverRanges {
    /// (pitch, yaw) [rad] of both gazes, 2 x 2: a column an eye.
    Columns<T> gaze_low = Columns<T>::Zero(2, 2), gaze_high = Columns<T>::Zero(2, 2);
    VecX<T> expression_low, expression_high; ///< E
};

/// An avatar that can be shown without its run or capture.
template <class T>
struct PlayableAvatar {
    std::string name; ///< of the subject, UTF-8, may be empty
    AvatarConfig config;
    LandmarkRoles roles;
    TrainedAvatar<T> avatar;
    std::vector<std::string> expression_names; ///< E, or empty
    /// The frame that the avatar is first shown at, with that frame's gazes: gaze_vector(0, 0)
    /// looks ahead. They, and those of `ranges`, are visual axes if the avatar has a kappa, else
    /// optical ones.
    Drivers<T> neutral;
    DriverRanges<T> ranges;
    /// The camera of the picture after super-resolution. The head at `neutral` in it is as large as
    /// in the pictures of training.
    Pinhole<T> camera;
    VecX<T> background; ///< feature of what is behind the head, C

    /// Returns true if gazes are visual axes, of which kappa makes optical ones.
    bool visual_axes() const { return avatar.eyes.kappa.size() > 0; }
};

/// The place of a head at its neutral drivers [world units].
template <class T>
struct HeadPlace {
    Vec3<T> middle; ///< of the box around the face's points at rest
    T radius;       ///< nine of ten of them are nearer to the middle
};

/// Returns where the avatar's head is, from the points of its face.
template <Real T>
HeadPlace<T> head_place(const PlayableAvatar<T>& p) {
    const Drivers<T>& d = p.neutral;
    const Columns<T>& x = p.avatar.face.position;
    const Mat3<T> r = so3_exp(Vec3<T>(d.pose.template head<3>()));
    const Vec3<T> middle = box_middle(x);
    std::vector<T> apart;
    for (Index i = 0; i < x.cols(); ++i) apart.push_back((x.col(i) - middle).norm());
    const auto tenth = apart.begin() + static_cast<std::ptrdiff_t>(apart.size() * 9 / 10);
    std::nth_element(apart.begin(), tenth, apart.end());
    return {d.scale * (r * middle) + Vec3<T>(d.pose.template tail<3>()), d.scale * *tenth};
}

/// The camera of the render whose super-resolution, `factor` times larger, has the first columns
/// and rows of the camera's picture: the same view, of whole blocks of factor x factor pixels.
template <Real T>
Pinhole<T> render_camera(const Pinhole<T>& camera, int factor) {
    require(factor > 0, "render_camera", "got the factor ", factor, ", expected 1 or more");
    const auto up = [factor](int side) { return (side + factor - 1) / factor * factor; };
    Pinhole<T> whole = camera;
    whole.width = up(camera.width);
    whole.height = up(camera.height);
    return scaled(whole, 1.0 / factor);
}

namespace detail {

/// The message is built only on failure: arrays are long, and drivers are checked each frame.
template <class A>
void require_all_finite(const std::string& who, const std::string& name, const A& a) {
    if (a.allFinite()) return;
    for (Index i = 0; i < a.size(); ++i)
        require(std::isfinite(a(i)), who, "'", name, "': value ", i, " is ", a(i),
                ", expected a finite number");
}

template <class T>
void check_ranges(const std::string& who, const std::string& name, const Columns<T>& low,
                  const Columns<T>& high) {
    require_all_finite(who, name, low);
    require_all_finite(who, name, high);
    for (Index i = 0; i < low.size(); ++i)
        require(low(i) <= high(i), who, "'", name, "': range ", i, " is from ", low(i), " to ",
                high(i), ", expected an end above its beginning");
}

} // namespace detail

/// Throws Error("who: ...") unless the drivers suit the configuration: the number of expression
/// coefficients, finite numbers, a positive scale, and gazes of length 1 to 1e-3.
template <Real T>
void check_drivers(const std::string& who, const AvatarConfig& config, const Drivers<T>& d) {
    if (d.expression.size() != config.expression)
        throw Error(who + ": 'expression': got " + std::to_string(d.expression.size()) +
                    " coefficients, expected " + std::to_string(config.expression));
    detail::require_all_finite(who, "expression", d.expression);
    detail::require_all_finite(who, "pose", d.pose);
    if (!(std::isfinite(d.scale) && d.scale > T(0)))
        throw Error(who + ": 'scale': got " + number_text(d.scale) +
                    ", expected a positive number");
    for (std::size_t eye = 0; eye < 2; ++eye) {
        const T length = norm(d.gaze[eye]);
        if (!(std::abs(length - T(1)) <= T(1e-3)))
            throw Error(who + ": 'gaze': the " + (eye == 0 ? "left" : "right") +
                        " eye's has the length " + number_text(length) + ", expected 1");
    }
}

namespace detail {

/// Throws Error("who: ...") with the first fault: shapes that do not belong together, indices of
/// landmarks that do not exist, numbers that are not finite, bad drivers, ranges or camera.
template <Real T>
void check_playable(const std::string& who, const PlayableAvatar<T>& p) {
    const AvatarConfig& c = p.config;
    const auto shape = [&](const std::string& name, const auto& a, Index rows, Index cols) {
        require(a.rows() == rows && a.cols() == cols, who, "'", name, "': got shape (", a.cols(),
                ", ", a.rows(), "), expected (", cols, ", ", rows, ")");
    };
    const auto& f = p.avatar.face;
    const auto& e = p.avatar.eyes;
    const Index n = std::max<Index>(f.position.cols(), 1),
                m = std::max<Index>(e.position.cols(), 2);
    shape("face.xyz", f.position, 3, n);
    shape("face.feature", f.feature, c.feature, n);
    shape("face.scales", f.log_scale, 3, n);
    shape("face.rotation", f.rotation, 4, n);
    shape("face.opacity", f.opacity_logit, 1, n);
    shape("face.landmarks_3d_neutral", f.landmarks, 3, std::max<Index>(f.landmarks.cols(), 1));
    shape("eyes.xyz", e.position, 3, m);
    shape("eyes.feature", e.feature, c.channels, m);
    shape("eyes.scales", e.log_scale, 3, m);
    shape("eyes.rotation", e.rotation, 4, m);
    shape("eyes.opacity", e.opacity_logit, 1, m);
    shape("eyes.centre", e.centre, 3, 2);
    if (p.visual_axes()) shape("eyes.kappa", e.kappa, 2, 2);
    const Shading<T>& light = p.avatar.shading;
    shape("shading.light", light.light, light.any() ? 8 : 0, light.any() ? 3 : 0);
    shape("shading.normal", light.normal, light.any() ? 3 : 0, light.any() ? n : 0);
    shape("shading.eye_normal", light.eye_normal, light.any() ? 3 : 0, light.any() ? 2 : 0);
    const ViewColors<T>& view = p.avatar.view_color;
    if (view.any()) {
        const Index rows = view.face.rows();
        require(rows == 9 || rows == 24 || rows == 45, who, "'view_color.face': got ", rows,
                " coefficients, expected 9, 24 or 45");
        shape("view_color.face", view.face, rows, n);
        shape("view_color.eyes", view.eyes, rows, m);
    }
    const EyeOptics<T, TrainedEffects>& o = e.optics;
    if (o.sees_cornea()) {
        shape("eyes.cornea", o.cornea, cornea_numbers, 2);
        detail::require_all_finite(who, "eyes.cornea", o.cornea);
        require(o.cornea.row(3).minCoeff() > T(0), who, "'eyes.cornea': a radius is not positive");
    }
    if (o.refracts()) {
        shape("eyes.refractive_index", o.index, 1, 2);
        for (Index eye = 0; eye < 2; ++eye)
            require(o.index(eye) >= T(0.5) && o.index(eye) <= T(3), who,
                    "'eyes.refractive_index': got ", o.index(eye), ", expected 0.5 to 3");
    }
    if (o.lights() > 0) {
        require(o.lights() <= most_lights, who, "got ", o.lights(), " lights, expected at most ",
                most_lights);
        shape("eyes.light_position", o.light_position, 3, o.lights());
        shape("eyes.light_intensity", o.light_intensity, light_channels, o.lights());
        shape("eyes.light_width", o.light_width, 1, o.lights());
        detail::require_all_finite(who, "eyes.light_width", o.light_width);
        require(o.light_width.minCoeff() > T(0), who,
                "'eyes.light_width': a width is not positive");
    }
    if (e.has_lid_shadow()) {
        shape("eyes.lid_shadow", e.lid_shadow, lid_numbers, 2);
        try {
            check_lids(e, n);
        } catch (const Error& fault) {
            throw Error(who + ": " + fault.what());
        }
    }
    require(e.points_of(0) >= 1 && e.points_of(1) >= 1, who, "the left eyeball has ",
            e.points_of(0), " of ", m, " points, expected at least one in each");
    const auto landmarks = [&](const char* name, const std::vector<Index>& list) {
        require(!list.empty(), who, "'", name, "': got none, expected landmarks");
        for (const Index i : list)
            require(i >= 0 && i < f.landmarks.cols(), who, "'", name, "': got landmark ", i,
                    ", expected 0 to ", f.landmarks.cols() - 1);
    };
    landmarks("roles.expression", p.roles.expression);
    landmarks("roles.left_eye", p.roles.eye[0]);
    landmarks("roles.right_eye", p.roles.eye[1]);
    const auto finite = [&](const std::string& name, const auto& a) {
        detail::require_all_finite(who, name, a);
    };
    TrainedAvatar<T>::fields(finite, p.avatar);
    finite("face.landmarks_3d_neutral", f.landmarks);
    finite("eyes.xyz", e.position);
    finite("eyes.centre", e.centre);
    check_drivers(who + ": neutral", c, p.neutral);
    shape("range.expression", p.ranges.expression_low, c.expression, 1);
    shape("range.expression", p.ranges.expression_high, c.expression, 1);
    shape("range.gaze", p.ranges.gaze_low, 2, 2);
    shape("range.gaze", p.ranges.gaze_high, 2, 2);
    detail::check_ranges<T>(who, "range.expression", p.ranges.expression_low,
                            p.ranges.expression_high);
    detail::check_ranges<T>(who, "range.gaze", p.ranges.gaze_low, p.ranges.gaze_high);
    require(
        p.expression_names.empty() || static_cast<Index>(p.expression_names.size()) == c.expression,
        who, "got names of ", p.expression_names.size(), " expression coefficients, expected ",
        c.expression);
    check_camera(who, p.camera);
    shape("background", p.background, c.channels, 1);
    finite("background", p.background);
}

} // namespace detail

} // namespace rye
