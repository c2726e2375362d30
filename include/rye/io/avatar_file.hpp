// SPDX-License-Identifier: Apache-2.0
/// rye/io/avatar_file.hpp: one file with all that is needed to show an avatar: NAME.avatar, a
/// safetensors file with format, version, settings and a checksum in its metadata; docs/runs.md has
/// the tables. Positions are F32, the other parameters F16 or F32, so that a file is a few
/// megabytes. Nothing in it depends on a path, a capture or a clock.
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
#include <rye/io/avatar_arrays.hpp>
#include <rye/io/avatar_settings.hpp>
#include <rye/io/safetensors.hpp>
#include <rye/core/format.hpp>

namespace rye {

/// Name of the format in the file's metadata.
inline constexpr const char* avatar_format = "rye-avatar";
/// Version of the format that is written for avatars whose colours depend on the view. Those
/// without are of version 5 if their corneas refract, else of 4 if their lids cast shadows, else of
/// 3, whose readers know none of them. Readers
/// also accept version 2, whose avatars have no highlights, and version 1, whose avatars have no
/// light and no driven eyes either, and a separate kappa.
inline constexpr const char* avatar_version = "6";

/// How an avatar file stores parameters other than positions.
enum class AvatarPrecision {
    half, ///< F16, but F32 for an array with a number above 65504
    full  ///< F32
};

namespace detail {

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

/// Returns true if a file has a part, by its word: off or on. Throws an Error for another word, and
/// if the part's first tensor is present with the word off or absent with the word on.
inline bool has_part(const Safetensors& file, const std::string& who, const std::string& key,
                     const std::array<std::string, 2>& words, const std::string& tensor) {
    const std::string& word = file.word(key);
    require(word == words[0] || word == words[1], who, "metadata '", key, "': got '", word,
            "', expected '", words[0], "' or '", words[1], "'");
    const bool on = word == words[1];
    require(on == file.has(tensor), who,
            on ? "the tensor '" + tensor + "' is missing, though '" + key + "' is '" + word + "'"
               : "got a tensor '" + tensor + "', expected none: '" + key + "' is '" + word + "'");
    return on;
}

/// Returns a matrix that the file stores as F32 or F16.
template <class T>
Columns<T> avatar_array(const Safetensors& file, const std::string& name) {
    if (file.at(name).type == TensorType::f16)
        return file.columns<Eigen::half>(name).template cast<T>();
    return file.columns<float>(name).template cast<T>();
}

} // namespace detail

/// Replaces the file at `path` by one with this avatar; on failure leaves it unchanged and throws
/// an Error. Checks the avatar first (check_playable). Returns the bytes written.
template <Real T>
std::uint64_t write_avatar(const std::filesystem::path& path, const PlayableAvatar<T>& p,
                           AvatarPrecision precision = AvatarPrecision::half) {
    const std::string who = path.string() + ": not written";
    detail::check_playable(who, p);
    detail::check_networks(who, p.avatar, p.config);
    std::deque<Columns<float>> wide; // arrays that the entries refer to
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

    const AvatarSettings settings{p.config, p.avatar.upsampler.shape}; // named, for nvcc
    const bool lids = p.avatar.eyes.has_lid_shadow(), refracts = p.avatar.eyes.optics.refracts(),
               view = p.avatar.view_color.any();
    TensorMetadata metadata{
        {"format", avatar_format},
        {"version", view       ? avatar_version
                    : refracts ? "5"
                    : lids     ? "4"
                               : "3"},
        {"name", p.name},
        {"settings", detail::settings_text(settings)},
        {"gaze_axis", p.visual_axes() ? "visual" : "optical"},
        {"eye_appearance", has_driven_eyes(p.avatar) ? "driven" : "free"},
        {"shading", p.avatar.shading.any() ? "head_pose" : "none"},
        {"highlights", p.avatar.eyes.optics.lights() > 0 ? "lights" : "none"},
        {"left_eye_points", std::to_string(p.avatar.eyes.points_of(0))},
        {"expression_names", detail::names_text(p.expression_names)},
    };
    if (view) metadata["view_color"] = "harmonics";
    if (refracts || view) metadata["refraction"] = refracts ? "cornea" : "none";
    if (lids || refracts || view) metadata["lid_shadow"] = lids ? "lids" : "none";
    std::uint64_t bytes = 0;
    for (const TensorEntry& t : entries) bytes += t.bytes.size();
    write_safetensors(path, std::move(entries), std::move(metadata));
    return bytes;
}

/// Returns the avatar in a file's bytes. Throws an Error "who: ..." for a file of another kind or
/// version, for a damaged one, and for whatever check_playable rejects; allocates nothing of a size
/// that the settings state but the file does not have.
template <Real T>
PlayableAvatar<T> parse_avatar(ByteSpan bytes, const std::string& who) {
    const Safetensors file = parse_safetensors(bytes, who);
    const auto found = file.metadata().find("format");
    require(found != file.metadata().end() && found->second == avatar_format, who,
            "metadata 'format': got ",
            (found == file.metadata().end() ? std::string("none") : "'" + found->second + "'"),
            ", expected '", avatar_format,
            "'; `rye export --run RUN --out NAME.avatar` writes such a file");
    const bool first = file.word("version") == "1", second = file.word("version") == "2",
               third = file.word("version") == "3", fourth = file.word("version") == "4",
               fifth = file.word("version") == "5";
    const bool sixth = file.word("version") == avatar_version;
    require(first || second || third || fourth || fifth || sixth, who, "metadata 'version': got '",
            file.word("version"), "', expected '1', '2', '3', '4', '5' or '", avatar_version, "'");
    require(file.checked(), who, "the metadata 'checksum' is missing");
    PlayableAvatar<T> p;
    p.name = file.word("name");
    const AvatarSettings settings =
        detail::parse_settings(file.word("settings"), who + ": metadata 'settings'");
    p.config = settings.avatar;
    p.expression_names =
        detail::parse_names(file.word("expression_names"), who + ": metadata 'expression_names'");
    const char* const kappa = first ? "kappa" : "avatar.eyes.kappa";
    const bool visual = detail::has_part(file, who, "gaze_axis", {"optical", "visual"}, kappa);
    const bool driven = !first && detail::has_part(file, who, "eye_appearance", {"free", "driven"},
                                                   "avatar.eyes.left_appearance_mlp.conv0.weight");
    const bool light = !first && detail::has_part(file, who, "shading", {"none", "head_pose"},
                                                  "avatar.shading.light");
    const char* const lights = "avatar.eyes.light_position";
    const bool highlights =
        !first && !second &&
        detail::has_part(file, who, "highlights", {"none", "lights"}, lights);
    const bool lids =
        !first && !second && !third &&
        detail::has_part(file, who, "lid_shadow", {"none", "lids"}, "avatar.eyes.lid_shadow");
    const bool refracts =
        (fifth || sixth) && detail::has_part(file, who, "refraction", {"none", "cornea"},
                                             "avatar.eyes.refractive_index");
    const bool view = sixth && detail::has_part(file, who, "view_color", {"none", "harmonics"},
                                                "avatar.view_color.face");
    // Layers and parts without numbers, to be replaced by the file's.
    detail::each_network(p.avatar, p.config, driven,
                         [](const std::string&, auto& net, const MlpShape& s) {
                             net.shape = s;
                             net.weight.resize(static_cast<std::size_t>(s.layers()));
                             net.bias.resize(static_cast<std::size_t>(s.layers()));
                         });
    if (light) p.avatar.shading.light.resize(8, 3);
    if (view) p.avatar.view_color.face.resize(9, 1);
    if (visual && !first) p.avatar.eyes.kappa.resize(2, 2);
    if (highlights) {
        const std::vector<Index>& got = file.at(lights).shape;
        require(got.size() == 2 && got[0] >= 1 && got[0] <= most_lights && got[1] == 3, who,
                lights, ": got shape ", [&] { return shape_text(got); },
                ", expected (1 to ", most_lights, ", 3)");
        resize_lights(p.avatar.eyes.optics, got[0]);
    }
    if (refracts) set_refraction(p.avatar.eyes.optics, 1);
    if (lids) p.avatar.eyes.lid_line.resize(3, 2);
    p.avatar.upsampler.shape = settings.upsampler;
    p.avatar.upsampler.conv.resize(static_cast<std::size_t>(settings.upsampler.layers()));
    detail::avatar_arrays(p.avatar, [&](const std::string& name, Columns<T>& a, bool) {
        a = detail::avatar_array<T>(file, name);
    });
    if (visual && first)
        p.avatar.eyes.kappa = file.columns<double>(kappa, 2, 2).template cast<T>();
    if (visual) detail::require_shape(who + ": " + kappa, p.avatar.eyes.kappa, 2, 2);
    if (light)
        detail::require_shape(who + ": avatar.shading.light", p.avatar.shading.light, 8, 3);
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
            who, "metadata 'left_eye_points': got '", left, "', expected a whole number from 1 to ",
            points - 1);
    p.avatar.eyes.left_points = left_points;
    const auto list = [&](const char* name, std::vector<Index>& indices) {
        const std::vector<Index>& shape = file.at(name).shape;
        require(
            shape.size() == 1, [&] { return who + ": " + name; }, "got shape ",
            [&] { return shape_text(shape); }, ", expected one extent");
        for (const std::int64_t i : file.values<std::int64_t>(name, shape)) {
            require(
                i >= 0 && i < p.avatar.face.landmarks.cols(), [&] { return who + ": " + name; },
                "got landmark ", i, ", expected 0 to ", p.avatar.face.landmarks.cols() - 1);
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
            require(
                a.rows() == rows, [&] { return who + ": " + name; }, "got ", a.rows(),
                " rows, expected ", rows);
            detail::require_all_finite(who, name, a);
        },
        scalars);
    detail::set_scalars(scalars, who, p);
    detail::check_playable(who, p);
    return p;
}

/// Returns the avatar in a file. Throws an Error as parse_avatar does, with the path.
template <Real T>
PlayableAvatar<T> read_avatar(const std::filesystem::path& path) {
    return parse_avatar<T>(read_file(path), path.string());
}

} // namespace rye
