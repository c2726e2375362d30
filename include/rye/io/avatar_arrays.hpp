// SPDX-License-Identifier: Apache-2.0
/// rye/io/avatar_arrays.hpp: the arrays of an avatar file: networks and their shapes, the
/// avatar's parameters under their checkpoint names, and the small arrays of the display settings.
#pragma once

#include <cmath>
#include <string>
#include <type_traits>

#include <rye/avatar/playable.hpp>
#include <rye/core/format.hpp>

namespace rye::detail {

/// Calls f(name, network, shape) for each network of an avatar, named after its fields.
/// driven_eyes: true if the frame drives the eyes' features.
template <class A, class F>
void each_network(A& avatar, const AvatarConfig& c, bool driven_eyes, F&& f) {
    const NetworkConfig& n = c.networks;
    auto& nets = avatar.face.networks;
    const int xyz = c.position_code(), pose = c.pose_code(), gaze = c.gaze_code();
    f("face.exp_color_mlp", nets.exp_color,
      mlp_shape(c.feature, c.expression, n.exp_color, c.channels));
    f("face.exp_deform_mlp", nets.exp_deform, mlp_shape(xyz, c.expression, n.exp_deform, 3));
    f("face.pose_color_mlp", nets.pose_color, mlp_shape(c.feature, pose, n.pose_color, c.channels));
    f("face.pose_deform_mlp", nets.pose_deform, mlp_shape(xyz, pose, n.pose_deform, 3));
    for (std::size_t eye = 0; eye < 2; ++eye) {
        const std::string side = eye == 0 ? "face.left" : "face.right";
        f(side + "gaze_deform_mlp", nets.gaze_deform[eye], mlp_shape(xyz, gaze, n.gaze_deform, 3));
        f(side + "gaze_color_mlp", nets.gaze_color[eye],
          mlp_shape(c.feature, gaze, n.gaze_color, c.channels));
    }
    f("face.exp_attributes_mlp", avatar.face.exp_attributes,
      mlp_shape(c.feature, c.expression, n.exp_attributes, 8));
    f("face.pose_attributes_mlp", avatar.face.pose_attributes,
      mlp_shape(c.feature, pose, n.pose_attributes, 8));
    f("eyes.eye_offset_mlp", avatar.eyes.offset.mlp,
      mlp_shape(c.expression + pose, 0, n.eye_offset, 6));
    if (!driven_eyes) return;
    const MlpShape shape = DrivenFeatures::shape(appearance_sizes<TrainedEffects>(c, 0));
    for (std::size_t eye = 0; eye < 2; ++eye)
        f(eye == 0 ? "eyes.left_appearance_mlp" : "eyes.right_appearance_mlp",
          avatar.eyes.networks[eye], shape);
}

template <class A>
void require_shape(const std::string& who, const A& a, Index rows, Index cols) {
    require(a.rows() == rows && a.cols() == cols, who, "got shape (", a.cols(), ", ", a.rows(),
            "), expected (", cols, ", ", rows, ")");
}

/// Throws an Error unless the networks have the shapes that the settings state.
template <class T>
void check_networks(const std::string& who, const TrainedAvatar<T>& avatar,
                    const AvatarConfig& c) {
    const auto check = [&](const std::string& name, const auto& net, const MlpShape& s) {
        const auto layers = static_cast<std::size_t>(s.layers());
        require(
            net.weight.size() == layers && net.bias.size() == layers,
            [&] { return who + ": " + name; }, "got ", net.weight.size(), " layers, expected ",
            layers);
        for (int l = 0; l < s.layers(); ++l) {
            const auto i = static_cast<std::size_t>(l);
            const std::string layer = who + ": " + name + ".conv" + std::to_string(l);
            require_shape(layer + ".weight", net.weight[i], s.layer_out(l), s.fan_in(l));
            require_shape(layer + ".bias", net.bias[i], s.layer_out(l), 1);
        }
    };
    each_network(avatar, c, has_driven_eyes(avatar), check);
    const Upsampler<T>& u = avatar.upsampler;
    require(
        static_cast<int>(u.conv.size()) == u.shape.layers(), [&] { return who + ": upsampler"; },
        "got ", u.conv.size(), " layers, expected ", u.shape.layers());
    for (int l = 0; l < u.shape.layers(); ++l)
        require_shape(who + ": upsampler, layer " + std::to_string(l),
                      u.conv[static_cast<std::size_t>(l)], u.shape.block_out(l / 2),
                      Index(9) * u.shape.layer_in(l));
    require_shape(who + ": upsampler.outc.conv.weight", u.out_weight, 3, u.shape.capacity);
    require_shape(who + ": upsampler.outc.conv.bias", u.out_bias, 3, 1);
}

/// Calls f(name, array, precise) for each array of an avatar that a file stores: fields, then
/// buffers.
template <class A, class F>
void avatar_arrays(A& avatar, F&& f) {
    using P = std::remove_const_t<A>;
    const auto visit = [&](const std::string& name, auto& a) {
        // Needed in training alone.
        if (name == "delta_poses" || name == "delta_gazes" || name == "delta_views" ||
            name == "eyes.spacing")
            return;
        f("avatar." + name, a,
          name.ends_with(".xyz") || name == "eyes.kappa" || name == "eyes.light_position" ||
              name == "eyes.refractive_index" || name == "eyes.lid_shadow");
    };
    P::fields(visit, avatar);
    P::buffers(
        [&](const std::string& name, auto& a) {
            if (name != "eyes.spacing") f("avatar." + name, a, true);
        },
        avatar);
}

/// Small arrays of a file, in double, for writing and reading alike.
struct AvatarScalars {
    Columns<double> pose, scale, gaze, expression, gaze_range, expression_range, lens, rotation,
        translation, background;

    /// Calls f(name, array, rows) with the number of rows; the file has shape (columns, rows).
    template <class F, class S>
    static void fields(F&& f, S& s) {
        f("neutral.expression", s.expression, 1);
        f("neutral.pose", s.pose, 6);
        f("neutral.scale", s.scale, 1);
        f("neutral.gaze", s.gaze, 3);
        f("range.expression", s.expression_range, 2);
        f("range.gaze", s.gaze_range, 4);
        f("camera.lens", s.lens, 7);
        f("camera.rotation", s.rotation, 3);
        f("camera.translation", s.translation, 3);
        f("background", s.background, 1);
    }
};

template <class T>
AvatarScalars scalars_of(const PlayableAvatar<T>& p) {
    const auto to = [](const auto& a) { return Columns<double>(a.template cast<double>()); };
    AvatarScalars s;
    s.expression = to(p.neutral.expression.transpose());
    s.pose = to(p.neutral.pose);
    s.scale = Columns<double>::Constant(1, 1, static_cast<double>(p.neutral.scale));
    s.gaze.resize(3, 2);
    for (std::size_t eye = 0; eye < 2; ++eye)
        s.gaze.col(static_cast<Index>(eye)) = p.neutral.gaze[eye].template cast<double>();
    s.expression_range.resize(2, p.ranges.expression_low.size());
    s.expression_range.row(0) = to(p.ranges.expression_low.transpose());
    s.expression_range.row(1) = to(p.ranges.expression_high.transpose());
    s.gaze_range.resize(4, 2);
    s.gaze_range << to(p.ranges.gaze_low), to(p.ranges.gaze_high);
    const Pinhole<double> c = p.camera.template cast<double>();
    s.lens.resize(7, 1);
    s.lens << c.fx, c.fy, c.cx, c.cy, c.width, c.height, c.near_depth;
    s.rotation = c.camera_from_world.rotation.transpose(); // its rows are the file's columns
    s.translation = c.camera_from_world.translation;
    s.background = to(p.background.transpose());
    return s;
}

template <class T>
void set_scalars(const AvatarScalars& s, const std::string& who, PlayableAvatar<T>& p) {
    const auto columns = [&](const char* name, const Columns<double>& a, Index n) {
        require(
            a.cols() == n, [&] { return who + ": " + name; }, "got ", a.cols(),
            " columns, expected ", n);
    };
    columns("neutral.pose", s.pose, 1);
    columns("neutral.scale", s.scale, 1);
    columns("neutral.gaze", s.gaze, 2);
    columns("range.gaze", s.gaze_range, 2);
    columns("camera.lens", s.lens, 1);
    columns("camera.rotation", s.rotation, 3);
    columns("camera.translation", s.translation, 1);
    for (const int side : {4, 5})
        require(
            s.lens(side) >= 1 && s.lens(side) <= most_picture_side &&
                s.lens(side) == std::floor(s.lens(side)),
            [&] { return who + ": camera.lens"; }, "got a side of ", s.lens(side),
            " pixels, expected 1 to ", most_picture_side);
    p.neutral.expression = s.expression.row(0).transpose().template cast<T>();
    p.neutral.pose = s.pose.col(0).template cast<T>();
    p.neutral.scale = static_cast<T>(s.scale(0));
    for (std::size_t eye = 0; eye < 2; ++eye)
        p.neutral.gaze[eye] = s.gaze.col(static_cast<Index>(eye)).template cast<T>();
    p.ranges.expression_low = s.expression_range.row(0).transpose().template cast<T>();
    p.ranges.expression_high = s.expression_range.row(1).transpose().template cast<T>();
    p.ranges.gaze_low = s.gaze_range.topRows(2).template cast<T>();
    p.ranges.gaze_high = s.gaze_range.bottomRows(2).template cast<T>();
    Pinhole<T>& c = p.camera;
    c.fx = static_cast<T>(s.lens(0));
    c.fy = static_cast<T>(s.lens(1));
    c.cx = static_cast<T>(s.lens(2));
    c.cy = static_cast<T>(s.lens(3));
    c.width = static_cast<int>(s.lens(4));
    c.height = static_cast<int>(s.lens(5));
    c.near_depth = static_cast<T>(s.lens(6));
    c.camera_from_world.rotation = s.rotation.transpose().template cast<T>();
    c.camera_from_world.translation = s.translation.col(0).template cast<T>();
    p.background = s.background.row(0).transpose().template cast<T>();
}

} // namespace rye::detail
