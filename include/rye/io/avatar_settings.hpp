// SPDX-License-Identifier: Apache-2.0
/// rye/io/avatar_settings.hpp: conversion of an avatar's settings to and from the JSON object
/// in an avatar file's metadata. Names and units are those of AvatarConfig and UpsamplerShape.
#pragma once

#include <cmath>
#include <cstdint>
#include <string>
#include <type_traits>
#include <vector>

#include <rye/avatar/config.hpp>
#include <rye/io/json.hpp>
#include <rye/core/format.hpp>
#include <rye/nn/upsampler.hpp>

namespace rye {

/// Settings of the shapes of an avatar's networks, and of its influences.
struct AvatarSettings {
    AvatarConfig avatar;
    UpsamplerShape upsampler;

    /// Calls f(name, value, low, high) for each setting, with its bounds.
    template <class F, class S>
    static void fields(F&& f, S& s) {
        auto& a = s.avatar;
        f("expression", a.expression, 0, 1e6);
        f("feature", a.feature, 1, 4096);
        f("channels", a.channels, 3, 1024);
        f("frequencies", a.frequencies, 0, 20);
        f("pose_frequencies", a.pose_frequencies, 0, 20);
        f("gaze_frequencies", a.gaze_frequencies, 0, 20);
        f("exp_near", a.exp_near, 0, 1e6);
        f("exp_far", a.exp_far, 0, 1e6);
        f("gaze_near", a.gaze_near, 0, 1e6);
        f("gaze_far", a.gaze_far, 0, 1e6);
        f("metric", a.metric, 0, 0);
        f("deform_scale", a.deform_scale, 0, 100);
        f("attribute_scale", a.attribute_scale, 0, 100);
        auto& n = a.networks;
        f("exp_color", n.exp_color, 1, 65536);
        f("pose_color", n.pose_color, 1, 65536);
        f("exp_deform", n.exp_deform, 1, 65536);
        f("pose_deform", n.pose_deform, 1, 65536);
        f("exp_attributes", n.exp_attributes, 1, 65536);
        f("pose_attributes", n.pose_attributes, 1, 65536);
        f("gaze_deform", n.gaze_deform, 1, 65536);
        f("gaze_color", n.gaze_color, 1, 65536);
        f("eye_offset", n.eye_offset, 1, 65536);
        auto& u = s.upsampler;
        f("upsampler_capacity", u.capacity, 1, 1024);
        f("upsampler_doublings", u.doublings, 0, 4);
        f("upsampler_norm", u.norm, 0, 0);
        f("upsampler_skip", u.skip, 0, 0);
    }
};

namespace detail {

/// Returns the settings as a JSON object of one line.
inline std::string settings_text(const AvatarSettings& settings) {
    std::string text = "{";
    const auto write = [&](const char* name, const auto& value, double, double) {
        using V = std::remove_cvref_t<decltype(value)>;
        text += (text.size() == 1 ? "" : ",") + json_string(name) + ":";
        if constexpr (std::is_same_v<V, ChosenMetric>) {
            text += value.index() == 0 ? "\"squared\"" : "\"euclidean\"";
        } else if constexpr (std::is_same_v<V, Normalization>) {
            text += value == Normalization::instance ? "\"instance\"" : "\"none\"";
        } else if constexpr (std::is_same_v<V, bool>) {
            text += value ? "true" : "false";
        } else if constexpr (std::is_arithmetic_v<V>) {
            text += number_text(value);
        } else {
            std::string list;
            for (const int width : value) list += (list.empty() ? "" : ",") + std::to_string(width);
            text += "[" + list + "]";
        }
    };
    AvatarSettings::fields(write, settings);
    return text + "}";
}

/// Reads one setting from its JSON; throws an Error with its name, the value found and its bounds.
struct SettingReader {
    const JsonValue& object;
    const std::string& who;

    template <class V>
    void operator()(const char* name, V& value, double low, double high) const {
        const JsonValue* found = object.find(name);
        const std::string where = who + ": '" + name + "'";
        require(found != nullptr, where, "is missing");
        if constexpr (std::is_same_v<V, ChosenMetric>) {
            if (word(*found, where, "squared", "euclidean"))
                value = SquaredDistance{};
            else
                value = EuclideanDistance{};
        } else if constexpr (std::is_same_v<V, Normalization>) {
            value = word(*found, where, "instance", "none") ? Normalization::instance
                                                            : Normalization::none;
        } else if constexpr (std::is_same_v<V, bool>) {
            const auto* yes = found->template get<bool>();
            require(yes != nullptr, where, "expected true or false");
            value = *yes;
        } else if constexpr (std::is_same_v<V, int>) {
            value = whole(*found, where, low, high);
        } else if constexpr (std::is_same_v<V, double>) {
            const auto* integer = found->template get<std::int64_t>();
            const auto* real = found->template get<double>();
            require(integer != nullptr || real != nullptr, where, "expected a number");
            value = integer != nullptr ? static_cast<double>(*integer) : *real;
            require(std::isfinite(value) && value >= low && value <= high, where, "got ", value,
                    ", expected ", low, " to ", high);
        } else {
            const auto* list = found->template get<JsonArray>();
            require(list != nullptr && list->size() <= 64, where,
                    "expected a list of at most 64 widths of layers");
            value.clear();
            for (const JsonValue& width : *list) value.push_back(whole(width, where, low, high));
        }
    }

  private:
    static int whole(const JsonValue& v, const std::string& where, double low, double high) {
        const auto* integer = v.get<std::int64_t>();
        require(integer != nullptr, where, "expected a whole number");
        const auto real = static_cast<double>(*integer);
        require(real >= low && real <= high, where, "got ", *integer, ", expected ",
                static_cast<std::int64_t>(low), " to ", static_cast<std::int64_t>(high));
        return static_cast<int>(*integer);
    }
    static bool word(const JsonValue& v, const std::string& where, const std::string& yes,
                     const std::string& no) {
        const auto* text = v.get<std::string>();
        require(text != nullptr && (*text == yes || *text == no), where,
                (text != nullptr ? "got '" + *text + "', " : std::string()), "expected '", yes,
                "' or '", no, "'");
        return *text == yes;
    }
};

/// Reads settings_text's JSON; throws an Error with the name of the first setting that is missing,
/// of another type or outside its bounds. Further members are ignored.
inline AvatarSettings parse_settings(const std::string& text, const std::string& who) {
    const JsonValue json = parse_json(text, who);
    require(json.get<JsonObject>() != nullptr, who, "expected an object");
    AvatarSettings s;
    AvatarSettings::fields(detail::SettingReader{json, who}, s);
    require(s.avatar.exp_near <= s.avatar.exp_far, who, "'exp_near' is above 'exp_far'");
    require(s.avatar.gaze_near <= s.avatar.gaze_far, who, "'gaze_near' is above 'gaze_far'");
    s.upsampler.in_channels = s.avatar.channels;
    return s;
}

} // namespace detail

} // namespace rye
