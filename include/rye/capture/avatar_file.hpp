// SPDX-License-Identifier: Apache-2.0
/// rye/capture/avatar_file.hpp: one file with a whole avatar to show: NAME.avatar. A safetensors
/// file with format, version, settings and a checksum in its metadata; docs/formats.md has the
/// tables. Positions are F32, the other parameters F16 or F32, so that a file is a few megabytes.
/// Nothing in it depends on a path, a capture or a clock.
#pragma once

#include <array>
#include <charconv>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <span>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include <rye/avatar/playable.hpp>
#include <rye/capture/avatar_settings.hpp>
#include <rye/capture/safetensors.hpp>
#include <rye/core/format.hpp>

namespace rye {

/// Name of the format in the file's metadata.
inline constexpr const char* avatar_format = "rye-avatar";
/// Version of the format; readers refuse others.
inline constexpr const char* avatar_version = "1";

/// How an avatar file stores parameters other than positions.
enum class AvatarPrecision {
    half, ///< F16, but F32 for an array with a number above 65504
    full  ///< F32
};

namespace detail {

/// f(name, network, shape) for each network of an avatar; names are those of its fields.
template <class A, class F>
void each_network(A& avatar, const AvatarConfig& c, F&& f) {
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
}

template <class A>
void require_shape(const std::string& who, const A& a, Index rows, Index cols) {
    require(a.rows() == rows && a.cols() == cols, who,
            "got shape (" + std::to_string(a.cols()) + ", " + std::to_string(a.rows()) +
                "), expected (" + std::to_string(cols) + ", " + std::to_string(rows) + ")");
}

/// Throws Error unless the networks have the shapes that the settings state.
template <class T>
void check_networks(const std::string& who, const TwoStream<T>& avatar, const AvatarConfig& c) {
    each_network(avatar, c, [&](const std::string& name, const auto& net, const MlpShape& s) {
        const auto layers = static_cast<std::size_t>(s.layers());
        require(net.weight.size() == layers && net.bias.size() == layers, who + ": " + name,
                "got " + std::to_string(net.weight.size()) + " layers, expected " +
                    std::to_string(layers));
        for (int l = 0; l < s.layers(); ++l) {
            const auto i = static_cast<std::size_t>(l);
            const std::string layer = who + ": " + name + ".conv" + std::to_string(l);
            require_shape(layer + ".weight", net.weight[i], s.layer_out(l), s.fan_in(l));
            require_shape(layer + ".bias", net.bias[i], s.layer_out(l), 1);
        }
    });
    const Upsampler<T>& u = avatar.upsampler;
    require(static_cast<int>(u.conv.size()) == u.shape.layers(), who + ": upsampler",
            "got " + std::to_string(u.conv.size()) + " layers, expected " +
                std::to_string(u.shape.layers()));
    for (int l = 0; l < u.shape.layers(); ++l)
        require_shape(who + ": upsampler, layer " + std::to_string(l),
                      u.conv[static_cast<std::size_t>(l)], u.shape.block_out(l / 2),
                      Index(9) * u.shape.layer_in(l));
    require_shape(who + ": upsampler.outc.conv.weight", u.out_weight, 3, u.shape.capacity);
    require_shape(who + ": upsampler.outc.conv.bias", u.out_bias, 3, 1);
}

/// f(name, array, precise) for each array of an avatar that a file has: fields, then buffers.
template <class A, class F>
void avatar_arrays(A& avatar, F&& f) {
    using P = std::remove_const_t<A>;
    const auto visit = [&](const std::string& name, auto& a) {
        if (name == "delta_poses" || name == "eyes.spacing") return; // for training alone
        f("avatar." + name, a, name.ends_with(".xyz"));
    };
    P::fields(visit, avatar);
    P::buffers(
        [&](const std::string& name, auto& a) {
            if (name != "eyes.spacing") f("avatar." + name, a, true);
        },
        avatar);
}

/// The small arrays of a file, in one place for both directions, in double.
struct AvatarScalars {
    Columns<double> pose, scale, gaze, expression, gaze_range, expression_range, lens, rotation,
        translation, background;

    /// f(name, array, rows) with the number of rows; the file has shape (columns, rows).
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
    s.rotation = c.camera_from_world.rotation.transpose(); // a row of it is a column of the file
    s.translation = c.camera_from_world.translation;
    s.background = to(p.background.transpose());
    return s;
}

template <class T>
void set_scalars(const AvatarScalars& s, const std::string& who, PlayableAvatar<T>& p) {
    const auto columns = [&](const char* name, const Columns<double>& a, Index n) {
        require(a.cols() == n, who + ": " + name,
                "got " + std::to_string(a.cols()) + " columns, expected " + std::to_string(n));
    };
    columns("neutral.pose", s.pose, 1);
    columns("neutral.scale", s.scale, 1);
    columns("neutral.gaze", s.gaze, 2);
    columns("range.gaze", s.gaze_range, 2);
    columns("camera.lens", s.lens, 1);
    columns("camera.rotation", s.rotation, 3);
    columns("camera.translation", s.translation, 1);
    for (const int side : {4, 5})
        require(s.lens(side) >= 1 && s.lens(side) <= most_picture_side &&
                    s.lens(side) == std::floor(s.lens(side)),
                who + ": camera.lens",
                "got a side of " + number_text(s.lens(side)) + " pixels, expected 1 to " +
                    std::to_string(most_picture_side));
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

inline std::string names_text(const std::vector<std::string>& names) {
    std::string text = "[";
    for (const std::string& name : names) text += (text.size() == 1 ? "" : ",") + json_string(name);
    return text + "]";
}

inline std::vector<std::string> parse_names(const std::string& text, const std::string& who) {
    const JsonValue json = parse_json(text, who);
    require(json.get<JsonArray>() != nullptr, who, "expected a list of names");
    std::vector<std::string> names;
    for (const JsonValue& name : *json.get<JsonArray>()) {
        require(name.get<std::string>() != nullptr, who, "expected a list of names");
        names.push_back(*name.get<std::string>());
    }
    return names;
}

/// A matrix that the file has as F32 or F16.
template <class T>
Columns<T> avatar_array(const Safetensors& file, const std::string& name) {
    if (file.at(name).type == TensorType::f16)
        return file.columns<Eigen::half>(name).template cast<T>();
    return file.columns<float>(name).template cast<T>();
}

} // namespace detail

/// Replaces the file at `path` by one with this avatar; on failure leaves it unchanged and throws
/// Error. The avatar is checked first (check_playable). Returns the bytes written.
template <Real T>
std::uint64_t write_avatar(const std::filesystem::path& path, const PlayableAvatar<T>& p,
                           AvatarPrecision precision = AvatarPrecision::half) {
    const std::string who = path.string() + ": not written";
    check_playable(who, p);
    detail::check_networks(who, p.avatar, p.config);
    std::deque<Columns<float>> wide; // what the entries refer to
    std::deque<Columns<Eigen::half>> narrow;
    std::deque<std::vector<std::int64_t>> lists;
    std::vector<TensorEntry> entries;
    constexpr float most_half = 65504;
    detail::avatar_arrays(p.avatar, [&](const std::string& name, const auto& a, bool precise) {
        Columns<float> values = a.template cast<float>();
        const bool fits = values.size() == 0 || values.cwiseAbs().maxCoeff() <= most_half;
        if (precise || precision == AvatarPrecision::full || !fits) {
            wide.push_back(std::move(values));
            entries.push_back(tensor_entry(name, wide.back()));
        } else {
            narrow.push_back(values.template cast<Eigen::half>());
            entries.push_back(tensor_entry(name, narrow.back()));
        }
    });
    const auto list = [&](const char* name, const std::vector<Index>& indices) {
        lists.emplace_back(indices.begin(), indices.end());
        const auto n = static_cast<Index>(indices.size());
        entries.push_back(tensor_entry<std::int64_t>(name, {n}, lists.back()));
    };
    list("roles.expression", p.roles.expression);
    list("roles.left_eye", p.roles.eye[0]);
    list("roles.right_eye", p.roles.eye[1]);
    const detail::AvatarScalars scalars = detail::scalars_of(p);
    detail::AvatarScalars::fields([&](const char* name, const Columns<double>& a,
                                      Index) { entries.push_back(tensor_entry(name, a)); },
                                  scalars);
    Columns<double> kappa = p.kappa.template cast<double>();
    if (kappa.size() > 0) entries.push_back(tensor_entry("kappa", kappa));

    TensorMetadata metadata{
        {"format", avatar_format},
        {"version", avatar_version},
        {"name", p.name},
        {"settings", settings_text({p.config, p.avatar.upsampler.shape})},
        {"gaze_axis", kappa.size() > 0 ? "visual" : "optical"},
        {"left_eye_points", std::to_string(p.avatar.eyes.points_of(0))},
        {"expression_names", detail::names_text(p.expression_names)},
    };
    std::uint64_t bytes = 0;
    for (const TensorEntry& t : entries) bytes += t.bytes.size();
    write_safetensors(path, std::move(entries), std::move(metadata));
    return bytes;
}

/// The avatar of a file's bytes. Throws Error("who: ...") for a file of another kind or version, a
/// damaged one, and whatever check_playable refuses; nothing is allocated of a size that the
/// settings state and the file does not have.
template <Real T>
PlayableAvatar<T> parse_avatar(ByteSpan bytes, const std::string& who) {
    const Safetensors file = parse_safetensors(bytes, who);
    const auto found = file.metadata().find("format");
    require(found != file.metadata().end() && found->second == avatar_format, who,
            "metadata 'format': got " +
                (found == file.metadata().end() ? std::string("none") : "'" + found->second + "'") +
                ", expected '" + avatar_format +
                "'; `rye export --run RUN --out NAME.avatar` writes such a file");
    require(file.word("version") == avatar_version, who,
            "metadata 'version': got '" + file.word("version") + "', expected '" + avatar_version +
                "'");
    require(file.checked(), who, "the metadata 'checksum' is missing");
    PlayableAvatar<T> p;
    p.name = file.word("name");
    const AvatarSettings settings =
        parse_settings(file.word("settings"), who + ": metadata 'settings'");
    p.config = settings.avatar;
    p.expression_names =
        detail::parse_names(file.word("expression_names"), who + ": metadata 'expression_names'");
    // Layers without arrays, which the file's take the place of.
    detail::each_network(p.avatar, p.config, [](const std::string&, auto& net, const MlpShape& s) {
        net.shape = s;
        net.weight.resize(static_cast<std::size_t>(s.layers()));
        net.bias.resize(static_cast<std::size_t>(s.layers()));
    });
    p.avatar.upsampler.shape = settings.upsampler;
    p.avatar.upsampler.conv.resize(static_cast<std::size_t>(settings.upsampler.layers()));
    detail::avatar_arrays(p.avatar, [&](const std::string& name, Columns<T>& a, bool) {
        a = detail::avatar_array<T>(file, name);
    });
    detail::check_networks(who, p.avatar, p.config);
    const Index points = p.avatar.eyes.position.cols();
    p.avatar.eyes.spacing.setZero(1, points);
    p.avatar.delta_pose.resize(6, 0);
    const std::string& left = file.word("left_eye_points");
    Index left_points = 0;
    const auto [stop, fault] =
        std::from_chars(left.data(), left.data() + left.size(), left_points);
    require(fault == std::errc() && stop == left.data() + left.size() && left_points >= 1 &&
                left_points < points,
            who,
            "metadata 'left_eye_points': got '" + left + "', expected a whole number from 1 to " +
                std::to_string(points - 1));
    p.avatar.eyes.left_points = left_points;
    const auto list = [&](const char* name, std::vector<Index>& indices) {
        const std::vector<Index>& shape = file.at(name).shape;
        require(shape.size() == 1, who + ": " + name,
                "got shape " + shape_text(shape) + ", expected one extent");
        for (const std::int64_t i : file.values<std::int64_t>(name, shape)) {
            require(i >= 0 && i < p.avatar.face.landmarks.cols(), who + ": " + name,
                    "got landmark " + std::to_string(i) + ", expected 0 to " +
                        std::to_string(p.avatar.face.landmarks.cols() - 1));
            indices.push_back(static_cast<Index>(i));
        }
    };
    list("roles.expression", p.roles.expression);
    list("roles.left_eye", p.roles.eye[0]);
    list("roles.right_eye", p.roles.eye[1]);
    detail::AvatarScalars scalars;
    detail::AvatarScalars::fields(
        [&](const char* name, Columns<double>& a, Index rows) {
            a = file.columns<double>(name);
            require(a.rows() == rows, who + ": " + name,
                    "got " + std::to_string(a.rows()) + " rows, expected " + std::to_string(rows));
            detail::require_all_finite(who, name, a);
        },
        scalars);
    detail::set_scalars(scalars, who, p);
    const bool visual = file.word("gaze_axis") == "visual";
    require(visual || file.word("gaze_axis") == "optical", who,
            "metadata 'gaze_axis': got '" + file.word("gaze_axis") +
                "', expected 'optical' or 'visual'");
    require(visual == file.has("kappa"), who,
            visual ? "the tensor 'kappa' is missing, though 'gaze_axis' is 'visual'"
                   : "got a tensor 'kappa', expected none: 'gaze_axis' is 'optical'");
    if (visual) p.kappa = file.columns<double>("kappa", 2, 2).template cast<T>();
    check_playable(who, p);
    return p;
}

/// As parse_avatar, of the file at `path`, which the message names.
template <Real T>
PlayableAvatar<T> read_avatar(const std::filesystem::path& path) {
    return parse_avatar<T>(read_file(path), path.string());
}

} // namespace rye
